"""Tracker that gives the data set's own poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError, require_least
from bench.geometry import se3
from bench.io.torch_files import from_state, to_state
from bench.registry import PluginConfig, register
from bench.types import Float, Mask, StereoFrame, TrackingResult, Trajectory


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
        self._tracked: Mask = np.zeros(0, dtype=bool)

    def start(self, dataset: Dataset) -> None:
        """Fetch the poses; raises ``BenchError`` when the data set has none."""
        self._truth = dataset.ground_truth()
        if self._truth is None or len(self._truth) == 0:
            raise BenchError(
                f"tracker=groundtruth: {dataset.label} has no ground-truth poses. Use tracker=stereo_orb, or add poses."
            )
        self._tracked = np.zeros(len(self._truth), dtype=bool)
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
        found = self._truth.numbers == frame.number
        if not found.any():
            return TrackingResult(None, "lost")
        self._tracked |= found
        return TrackingResult(self._truth.T_world_cam[found.argmax()], "ok")

    def trajectory(self) -> Trajectory:
        """Poses of the frames tracked so far."""
        assert self._truth is not None, "start() comes before trajectory()"
        truth, tracked = self._truth, self._tracked
        return Trajectory(truth.T_world_cam[tracked], truth.numbers[tracked], truth.timestamps[tracked])

    def state(self) -> dict[str, Any]:
        """Which poses were given so far."""
        return to_state({"tracked": self._tracked})

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._tracked = from_state(state)["tracked"]
