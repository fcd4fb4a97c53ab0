"""Contract of a tracker: stereo frames in, camera poses out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from bench.contracts.dataset import Dataset
from bench.contracts.map_view import MapView
from bench.io.array_store import ArrayStore
from bench.types import StereoFrame, TrackingResult, Trajectory


class Tracker(ABC):
    """Estimates ``T_world_cam`` of the left camera, frame by frame."""

    worth_caching: bool = False
    """Whether its answers may be shared between runs with the same frames and settings, and cost more than reading
    them: True for a tracker that looks at images and always says the same about them. One that ``uses_map`` or
    ``uses_depth`` never is shared."""
    uses_map: bool = False
    """True for a tracker that looks at the map: it gets ``use_map``, and the run goes in step, one frame at a time."""
    uses_depth: bool = False
    """True for a tracker that looks at depth: every frame comes with its ``depth``, from the ``stereo=`` of the run."""

    @property
    def reach_m(self) -> float:
        """How far the camera may move in a frame, in metres, for this tracker to follow; infinite (the default): no
        setting bounds it. `check-plugin` drives its own street that slowly."""
        return math.inf

    def weights(self) -> dict[str, Path]:
        """Files of network weights in use, by what they are for: they are part of a run's provenance and of the cache's
        key."""
        return {}

    @abstractmethod
    def start(self, dataset: Dataset) -> None:
        """Called once before the first frame. The data set gives the camera and, to ``groundtruth``, the poses."""

    def use_map(self, view: MapView) -> None:
        """The map to look at, for one that ``uses_map``; called once, after ``start`` and before the first frame."""
        raise NotImplementedError(f"{type(self).__name__} says uses_map and has no use_map()")

    @abstractmethod
    def track(self, frame: StereoFrame) -> TrackingResult:
        """Pose of this frame, as well as it is known now. Called once per frame, in order."""

    def finish(self) -> None:  # noqa: B027 - most trackers have nothing left to do
        """Called once after the last frame, also when the run ends early: for last corrections of poses, and the end of
        processes. ``trajectory`` is asked for afterwards too."""

    @abstractmethod
    def trajectory(self) -> Trajectory:
        """The best poses known now of all frames tracked so far (later corrections included; lost frames absent).

        Asking changes nothing, however often it is done.
        """

    def use_store(self, store: ArrayStore) -> None:  # noqa: B027 - few have so much that it matters
        """Where large pieces that never change may lie, so that a checkpoint need not hold them; called once, after
        ``start`` and before the first frame. ``state`` names, as ``"stored"``, the sets of the store that it builds on;
        others that were there when it was asked for are removed when the checkpoint has been written."""

    def state(self) -> dict[str, Any] | None:
        """All that tracking resumes from, for a checkpoint: CPU tensors, numbers, text, and lists and dicts of them.

        Asked for between two frames; what it gives must not change when tracking goes on. None (the default): the
        frames are tracked again after a kill, and runs with one that ``uses_map`` begin anew, since the map of then is
        gone.
        """
        return None

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave, to the same bits; called after ``start``, ``use_map`` and ``use_store``."""
        raise NotImplementedError(f"{type(self).__name__} gives a state() and has no restore() to resume from it")
