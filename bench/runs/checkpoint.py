"""Checkpoints of a run under way: what it has learned so far, so that a killed run is resumed from there.

What only grows (rows, events, poses) is added to files, and what is large and never changes lies in the parts' stores:
a checkpoint writes what is new. Where tracker or keyframer give no state, their frames are repeated up to that of the
checkpoint, which works for every plugin that gives the same answer twice.
"""

from __future__ import annotations

import json
import logging
import math
import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.errors import BenchError, first_line
from bench.io.array_store import ArrayStore
from bench.io.atomic import TEMPORARY_PATTERN, atomic_path
from bench.io.torch_files import load_tensors
from bench.runs.journal import Journal
from bench.types import Event, Float

CHECKPOINT_FOLDER = "checkpoint"
STORES = ("mapper", "tracker")
_FILE = "state.pt"
_JOURNALS = ("rows", "events", "keyframe_poses")
_AS_THEY_ARE = ("mapper", "random", "seeing")
_TOLD = ("seconds", "elapsed_s", "psnr_db", "peak_memory_gb", "resumed_after", "optimised")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Snapshot:
    """A run after ``len(rows)`` frames.

    ``rows`` are those of ``frames.csv``; ``mapper`` is what ``Mapper.state`` gave; ``seconds`` by stage, ``elapsed_s``
    of wall time; ``psnr_db`` of the newest keyframe; ``random`` is the state of torch's generator; ``events`` so far;
    ``keyframe_poses`` the (4, 4) that each mapped keyframe came with, in order. ``seeing``: the states of the front
    end's parts by kind, or "trajectory" once all frames are tracked; empty where they are to be repeated. ``obsolete``:
    by store, sets that these states have no use for. ``optimised``: the last optimisation is over, and the views in the
    run folder are of this map and trajectory.
    """

    rows: list[dict[str, Any]]
    mapper: dict[str, Any]
    seconds: dict[str, float]
    elapsed_s: float
    psnr_db: float
    peak_memory_gb: float
    random: torch.Tensor
    resumed_after: list[int]
    events: list[Event]
    keyframe_poses: list[Float]
    seeing: dict[str, Any]
    obsolete: dict[str, set[str]]
    optimised: bool

    def stored(self, kind: str) -> list[str]:
        """The sets that the state of a part builds on."""
        state = self.mapper if kind == "mapper" else self.seeing.get(kind, {})
        return list(state.get("stored", ()))


class Checkpoints:
    """The newest checkpoint of the run in ``folder``; written at most every ``every_s`` seconds (infinite = never).

    ``fingerprint`` stands for all that the run's result depends on; a checkpoint with another one is of no use.
    ``stores`` are for pieces of the parts that never change.
    """

    def __init__(self, folder: Path, fingerprint: str, every_s: float) -> None:
        self._folder = folder / CHECKPOINT_FOLDER
        self._fingerprint = fingerprint
        self._every_s = every_s
        self._asked = time.monotonic()
        self._gave_up = math.isinf(every_s)
        self.stores = {kind: ArrayStore(self._folder / kind) for kind in STORES}
        self._journals = {name: Journal(self._folder / f"{name}.jsonl") for name in _JOURNALS}

    def due(self, at_once: bool = False) -> bool:
        """Whether it is time for a checkpoint; whoever is told so takes care of it. ``at_once``: it is, if this run has
        any."""
        if self._gave_up or not (at_once or time.monotonic() - self._asked >= self._every_s):
            return False
        self._asked = time.monotonic()
        return True

    def give_up(self, why: str) -> None:
        """This run can have no checkpoints."""
        log.info("no checkpoints: %s", why)
        self._gave_up = True

    def failed(self, error: Exception) -> None:
        """One can't be written: that costs safety, not the run; a warning says so."""
        if not self._gave_up:
            log.warning("no checkpoint could be written, the run goes on without: %s", error)
        self._gave_up = True

    def unused(self, kind: str, state: dict[str, Any]) -> set[str]:
        """Sets in a part's store that the state it gave just now has no use for."""
        return set(self.stores[kind].names()).difference(state.get("stored", ()))

    def write(self, snapshot: Snapshot) -> None:
        """Make it the newest checkpoint."""
        if self._gave_up:
            return
        try:
            self._write(snapshot)
        except (OSError, BenchError) as error:
            self.failed(error)
        self._asked = time.monotonic()

    def load(self) -> Snapshot | None:
        """The checkpoint, or None where there is none that fits; one that does not is removed, and the log says why.

        The stores then hold what it builds on, and nothing else.
        """
        snapshot = self._load() if (self._folder / _FILE).is_file() else None
        if snapshot is None:
            self.remove()
            return None
        for kind, store in self.stores.items():
            store.discard(snapshot.stored(kind))
        return snapshot

    def remove(self) -> None:
        """Delete the checkpoint and what the stores hold; none is no error."""
        shutil.rmtree(self._folder, ignore_errors=True)
        self.stores = {kind: ArrayStore(self._folder / kind) for kind in STORES}
        self._journals = {name: Journal(self._folder / f"{name}.jsonl") for name in _JOURNALS}

    def _load(self) -> Snapshot | None:
        try:
            content = load_tensors(self._folder / _FILE)
            if content["fingerprint"] != self._fingerprint:
                log.info("code, packages or weights have changed since the checkpoint; the run begins anew")
                return None
            told = json.loads(content["told"])
            rows, events, poses = (self._journals[name].read(told["marks"][name]) for name in _JOURNALS)
            snapshot = Snapshot(
                rows=rows,
                events=[Event(**event) for event in events],
                keyframe_poses=[np.array(pose) for pose in poses],
                obsolete={},
                **{name: content[name] for name in _AS_THEY_ARE},
                **{name: told[name] for name in _TOLD},
            )
        except Exception as error:  # the unpickler raises whatever the damage leads to
            log.warning("the checkpoint in %s is damaged (%s); the run begins anew", self._folder, first_line(error))
            return None
        return snapshot

    def _write(self, snapshot: Snapshot) -> None:
        self._folder.mkdir(exist_ok=True)
        for leftover in self._folder.glob(TEMPORARY_PATTERN):
            leftover.unlink()
        marks = {
            "rows": self._journals["rows"].extend(snapshot.rows, dict),
            "events": self._journals["events"].extend(snapshot.events, asdict),
            "keyframe_poses": self._journals["keyframe_poses"].extend(snapshot.keyframe_poses, np.ndarray.tolist),
        }
        # As JSON, whose floats come back to the bit: numbers of numpy's own types would not pass weights_only.
        told = {name: getattr(snapshot, name) for name in _TOLD} | {"marks": marks}
        content = {
            "fingerprint": self._fingerprint,
            "told": json.dumps(told, default=lambda number: number.item()),
            **{name: getattr(snapshot, name) for name in _AS_THEY_ARE},
        }
        with atomic_path(self._folder / _FILE) as temporary:
            torch.save(content, temporary)
        for kind, names in snapshot.obsolete.items():
            for name in names:
                self.stores[kind].remove(name)
