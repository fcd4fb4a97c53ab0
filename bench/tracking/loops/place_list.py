"""All places of a run, in order; those of long ago lie on disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from bench.io.torch_files import from_state, to_state
from bench.tracking.descriptors import Ints, as_they_were
from bench.tracking.growing import Archive, Array, Growing
from bench.tracking.loops.places import BLOCK, Place

_COLUMNS = ("xy", "octave", "disparity", "descriptors")


class PlaceList:
    """Places by number. A block of them that is full goes to the archive, and is read from there."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._places: list[Place] = []
        self._keyframes = Growing(np.empty(0, np.int64))

    def append(self, place: Place) -> None:
        """Take in the next place."""
        self._places.append(place)
        self._keyframes.append(place.keyframe)
        first = len(self._places) - BLOCK
        if len(self._places) % BLOCK == 0:
            self._places[first:] = _separate(self._archive.put(f"places-{first}", _joined(self._places[first:])))

    @property
    def keyframes(self) -> Ints:
        """Index (n,) of each place's keyframe."""
        return self._keyframes.rows

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> Place:
        return self._places[number]

    def state(self) -> dict[str, Any]:
        """For a checkpoint: the places that are not in the archive."""
        full = len(self) // BLOCK * BLOCK
        return {"archived": full, "open": to_state(_joined(self._places[full:])) if len(self) > full else None}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._places = []
        for first in range(0, state["archived"], BLOCK):
            self._places += _separate(self._archive.get(f"places-{first}"))
        if state["open"] is not None:
            self._places += _separate(from_state(state["open"]))
        self._keyframes = Growing(np.array([place.keyframe for place in self._places], dtype=np.int64))


def _joined(places: Sequence[Place]) -> dict[str, Array]:
    """Places as arrays: one row each, and the keypoints of all one after another."""
    alone = ("keyframe", "least_disparity", "scale_factor", "sigma_px")
    rows = {name: np.array([getattr(place, name) for place in places]) for name in alone}
    columns = {name: np.concatenate([getattr(place, name) for place in places]) for name in _COLUMNS}
    return rows | columns | {"count": np.array([len(place) for place in places])}


def _separate(arrays: Mapping[str, Array]) -> list[Place]:
    """The places of ``_joined``, as views."""
    edges = np.append(0, np.cumsum(arrays["count"])).tolist()
    descriptors = as_they_were(arrays["descriptors"])
    return [
        Place(
            int(arrays["keyframe"][k]),
            arrays["xy"][a:b],
            arrays["octave"][a:b],
            arrays["disparity"][a:b],
            descriptors[a:b],
            float(arrays["least_disparity"][k]),
            float(arrays["scale_factor"][k]),
            float(arrays["sigma_px"][k]),
        )
        for k, (a, b) in enumerate(pairwise(edges))
    ]
