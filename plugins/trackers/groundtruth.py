"""Tracker that gives the data set's own poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError, require_least
from bench.geometry import se3
from bench.registry import PluginConfig, register
from bench.types import Float, StereoFrame, TrackingResult, Trajectory


@dataclass(frozen=True)
class GroundTruthConfig(PluginConfig):
    """How far the poses are from the true ones; by default they are those."""

    noise_m: float = 0.0
    """Standard deviation of an error in each direction, in metres, of every frame but the first."""
    noise_deg: float = 0.0
    """The same about each axis, in degrees."""
    noise_frames: int = 5
    """How many frames an error lasts: there is a new one every so many frames, and it changes evenly in between."""
    noise_seed: int = 0
    """Random seed of the errors."""

    def __post_init__(self) -> None:
        require_least("tracker", self, noise_m=0, noise_deg=0, noise_frames=1, noise_seed=0)


@register("tracker", "groundtruth", config=GroundTruthConfig)
class GroundTruth(Tracker):
    """The data set's own poses, to tell mapping from tracking (KITTI's are locally inconsistent: they cost 2-3 dB)."""

    def __init__(self, config: GroundTruthConfig) -> None:
        self._config = config
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
        if self._config.noise_m or self._config.noise_deg:
            errors = self._errors(np.arange(len(self._truth)))
            self._truth = replace(self._truth, T_world_cam=self._truth.T_world_cam @ se3.exp(errors))

    def _errors(self, places: npt.NDArray[np.int64]) -> Float:
        """Twists (N, 6) of the poses at these places of the trajectory."""
        c = self._config
        knots = np.random.default_rng(c.noise_seed).normal(size=(places[-1] // c.noise_frames + 2, 6))
        knots[0] = 0
        at = places / c.noise_frames
        before, share = at.astype(np.int64), (at % 1)[:, None]
        between = (1 - share) * knots[before] + share * knots[before + 1]
        return between * np.repeat([c.noise_m, np.deg2rad(c.noise_deg)], 3)

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
