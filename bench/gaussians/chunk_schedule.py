"""Which keyframes are learned from together, and when those left behind are done: the map in chunks along the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.types import Float


@dataclass
class ChunkSchedule:
    """Keyframes in chunks of neighbours: the newest one is ``open``, older ones are ``waiting`` for their last
    optimisation, and then go. All that have not gone are live.

    ``length_m``: way of the camera in a chunk. ``behind_m``: how far the camera is from all of a chunk that is due; the
    oldest one is due, too, with more than ``most`` live keyframes. With an infinite ``behind_m`` none ever is.
    """

    length_m: float
    behind_m: float
    most: int
    open: list[int] = field(default_factory=list)
    waiting: list[list[int]] = field(default_factory=list)

    @property
    def live(self) -> list[int]:
        """Numbers of the live keyframes, as they came."""
        return sorted([*(number for chunk in self.waiting for number in chunk), *self.open])

    def add(self, number: int, pose_of: Callable[[int], Float]) -> None:
        """A new keyframe; ``pose_of`` gives the ``T_world_cam`` of each."""
        self.open.append(number)
        way = np.linalg.norm(np.diff([pose_of(each)[:3, 3] for each in self.open], axis=0), axis=1).sum()
        if way >= self.length_m or len(self.open) > self.most // 4:
            self.waiting.append(self.open)
            self.open = []

    def due(self, place: Float, pose_of: Callable[[int], Float]) -> list[list[int]]:
        """The waiting chunks whose last optimisation is due, with the camera at ``place`` (3,), the oldest first."""
        if not np.isfinite(self.behind_m):
            return []
        crowded = len(self.live) > self.most
        return [
            chunk
            for at, chunk in enumerate(self.waiting)
            if (crowded and at == 0) or min(np.linalg.norm(pose_of(n)[:3, 3] - place) for n in chunk) >= self.behind_m
        ]

    def freeze(self, chunk: list[int]) -> None:
        """A waiting chunk is done."""
        self.waiting.remove(chunk)

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        return {"open": list(self.open), "waiting": [list(chunk) for chunk in self.waiting]}

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave."""
        self.open, self.waiting = list(state["open"]), list(state["waiting"])
