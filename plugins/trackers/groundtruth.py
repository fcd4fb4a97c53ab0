"""Tracker that gives the data set's own poses."""

from __future__ import annotations

import numpy as np

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.registry import PluginConfig, register
from bench.types import StereoFrame, TrackingResult, Trajectory


@register("tracker", "groundtruth")
class GroundTruth(Tracker):
    """The data set's own poses, to tell mapping from tracking (KITTI's are locally inconsistent: they cost 2-3 dB)."""

    def __init__(self, config: PluginConfig) -> None:
        self._truth: Trajectory | None = None
        self._tracked: list[int] = []

    def start(self, dataset: Dataset) -> None:
        """Fetch the poses; raises ``BenchError`` when the data set has none."""
        self._truth = dataset.ground_truth()
        self._tracked = []
        if self._truth is None or len(self._truth) == 0:
            raise BenchError(
                f"tracker=groundtruth: {dataset.label} has no ground-truth poses. Use tracker=stereo_orb, or add poses."
            )

    def track(self, frame: StereoFrame) -> TrackingResult:
        """The frame's true pose; a frame without ground truth is lost."""
        assert self._truth is not None, "start() comes before track()"
        T = self._truth.pose_of(frame.number)
        if T is None:
            return TrackingResult(None, "lost")
        self._tracked.append(frame.number)
        return TrackingResult(T, "ok")

    def trajectory(self) -> Trajectory:
        """Poses of the frames tracked so far."""
        assert self._truth is not None, "start() comes before trajectory()"
        tracked = np.isin(self._truth.numbers, self._tracked)
        truth = self._truth
        return Trajectory(truth.T_world_cam[tracked], truth.numbers[tracked], truth.timestamps[tracked])
