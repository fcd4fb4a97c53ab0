"""Arrays that grow row by row, and rows and sets of arrays that never change, kept in a store."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.io.array_store import ArrayStore
from bench.io.torch_files import from_state, to_state

log = logging.getLogger(__name__)

_GROUP = 1024
"""Rows that are put into the store together."""

Array = npt.NDArray[Any]


class Growing:
    """An array (n, ...) that rows are added to in constant time; ``rows`` is a view of those so far."""

    def __init__(self, rows: Array) -> None:
        self._buffer, self._count = np.array(rows), len(rows)

    def append(self, row: object) -> None:
        """Add a row at the end."""
        if self._count == len(self._buffer):
            more = np.empty((max(self._count, 64), *self._buffer.shape[1:]), self._buffer.dtype)
            self._buffer = np.concatenate([self._buffer, more])
        self._buffer[self._count] = row
        self._count += 1

    @property
    def rows(self) -> Array:
        """All rows so far; a view that may be written to, and that is of no use once a row is added."""
        return self._buffer[: self._count]

    def __len__(self) -> int:
        return self._count


class Archive:
    """Sets of arrays that never change: in a store where there is one that takes them, else in memory.

    ``state`` names what lies in the store, and holds the rest.
    """

    def __init__(self) -> None:
        self._store: ArrayStore | None = None
        self._stored: dict[str, None] = {}
        self._kept: dict[str, dict[str, Array]] = {}

    def use_store(self, store: ArrayStore) -> None:
        """Put what comes from now on into ``store``."""
        self._store = store

    def put(self, name: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Keep a set; returns its arrays as they are to be read from now on, mapped where they lie in the store."""
        if self._store is not None:
            try:
                self._store.put(name, arrays)
                self._stored[name] = None
                return self._store.get(name)
            except BenchError as error:
                log.warning("tracking goes on with what it knows in memory alone: %s", error)
        self._kept[name] = dict(arrays)
        return self._kept[name]

    def get(self, name: str) -> dict[str, Array]:
        """The arrays of a set, uint64 as such or as int64 with the same bits; raises as ``ArrayStore.get``."""
        if name in self._kept:
            return self._kept[name]
        assert self._store is not None, "use_store() comes before restore()"
        return self._store.get(name)

    def release(self) -> None:
        """What lies in the store no longer counts as memory until it is read again."""
        if self._store is not None:
            self._store.release()

    def __contains__(self, name: str) -> bool:
        return name in self._kept or name in self._stored

    def state(self) -> dict[str, Any]:
        """``stored`` and ``kept``, for a checkpoint."""
        return {"stored": list(self._stored), "kept": {name: to_state(arrays) for name, arrays in self._kept.items()}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state``."""
        self._stored = dict.fromkeys(state["stored"])
        self._kept = {name: from_state(arrays) for name, arrays in state["kept"].items()}

    def rows(self, name: str, columns: Mapping[str, Array], settled: int) -> dict[str, Any]:
        """For a checkpoint, columns (n, ...) of which the first ``settled`` rows never change: those are put into the
        archive in groups."""
        groups = settled // _GROUP
        for k in range(groups):
            group = f"{name}-{k}"
            if group not in self:
                self.put(group, {key: rows[k * _GROUP : (k + 1) * _GROUP].copy() for key, rows in columns.items()})
        return {"groups": groups, "rest": to_state({key: rows[groups * _GROUP :] for key, rows in columns.items()})}

    def rows_of(self, name: str, state: Mapping[str, Any]) -> dict[str, Array]:
        """The columns that ``rows`` was given."""
        parts = [*(self.get(f"{name}-{k}") for k in range(state["groups"])), from_state(state["rest"])]
        return {key: np.concatenate([part[key] for part in parts]) for key in parts[-1]}
