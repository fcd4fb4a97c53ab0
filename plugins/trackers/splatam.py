"""SplaTAM's tracking: the camera moves until the map, rendered from it, is the frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.baselines.splatam.camera_pose import IDENTITY, CameraPose, PoseOptimizer, extrapolated
from bench.baselines.splatam.tracking_loss import TrackingLoss
from bench.contracts.dataset import Dataset
from bench.contracts.map_view import MapView
from bench.contracts.tracker import Tracker
from bench.errors import BenchError, require_between, require_least
from bench.io.torch_files import from_state, to_state
from bench.registry import PluginConfig, register
from bench.tracking.growing import Growing
from bench.types import PinholeView, StereoFrame, TrackingResult, Trajectory


@dataclass(frozen=True)
class SplatamTrackerConfig(PluginConfig):
    """Settings of the tracker. The defaults are those that SplaTAM's authors have for Replica."""

    iterations: int = 40
    """Steps a frame; each renders the map once, forward and backward."""
    rotation_rate: float = 4e-4
    """Adam's rate of the quaternion (half the angle in radians that a step turns at most)."""
    translation_rate: float = 2e-3
    """Adam's rate of the translation: metres that a step moves at most in each direction."""
    constant_velocity: bool = True
    """Whether a frame starts where the motion before leads; false: at the pose before."""
    silhouette: float = 0.99
    """Pixels count where the map's alpha is above this."""
    depth_weight: float = 1.0
    """Weight of the sum of depth errors, in metres."""
    color_weight: float = 0.5
    """Weight of the sum of colour errors, of 0 to 1 in each channel."""
    retry_loss: float = 0.0
    """A frame gets as many steps again where the weighted depth loss of the last one is not below this (0: never);
    SplaTAM has 20000 for ScanNet++."""
    max_depth_m: float = field(default=float("inf"), metadata={"infinite": True})
    """Depth counts up to so many metres."""

    def __post_init__(self) -> None:
        require_least("tracker", self, iterations=1, rotation_rate=0, translation_rate=0, retry_loss=0)
        require_least("tracker", self, depth_weight=0, color_weight=0)
        require_between("tracker", self, 0, 1, "silhouette")
        if not self.max_depth_m > 0:
            raise BenchError(f"tracker.max_depth_m={self.max_depth_m} must be above 0; inf is no limit.")


@register("tracker", "splatam", config=SplatamTrackerConfig)
class SplatamTracker(Tracker):
    """SplaTAM's tracking (Keetha et al., 2024): silhouette-masked depth and colour errors of the map's render.

    Each frame starts at constant velocity and takes ``iterations`` steps of Adam over quaternion and translation,
    anew for each frame, down the sums of the errors of depth and colour where the map is sure. The pose is the one that
    the step from the lowest loss led to. The first frame is the world. No frame is lost; one with no pixel to compare
    stays at its prediction and says so.

    It differs from the original in the rasterizer (see ``mapper=splatam``), and in that a pose from which no pixel can
    be compared is not the best one, although its sum is 0. Poses and their steps are in float64.
    """

    uses_map = True
    uses_depth = True

    def __init__(self, config: SplatamTrackerConfig) -> None:
        self._config = config

    @property
    def reach_m(self) -> float:
        """A step of Adam moves at most about its rate along each axis; also where the motion before leads on, the first
        motion must be reached from standing still."""
        return self._config.iterations * self._config.translation_rate

    def start(self, dataset: Dataset) -> None:
        """Begin a new sequence with its camera."""
        self._camera = dataset.camera
        self._numbers, self._times = Growing(np.empty(0, np.int64)), Growing(np.empty(0))
        self._vectors, self._T_world_cam = Growing(np.empty((0, 7))), Growing(np.empty((0, 4, 4)))

    def use_map(self, view: MapView) -> None:
        """The map that frames are compared with."""
        view.require_images()
        self._map = view

    def track(self, frame: StereoFrame) -> TrackingResult:
        """The pose whose render is nearest to the frame; "predicted" where no pixel could be compared."""
        first = not len(self._numbers)
        pose, pixels = (IDENTITY, 0) if first else self._optimised(frame)
        T_world_cam = pose.T_world_cam
        for column, row in (
            (self._numbers, frame.number),
            (self._times, frame.timestamp),
            (self._vectors, pose.vector),
            (self._T_world_cam, T_world_cam),
        ):
            column.append(row)
        return TrackingResult(T_world_cam, "ok" if first or pixels else "predicted", pixels)

    def trajectory(self) -> Trajectory:
        """Poses of all frames so far; they are never corrected."""
        return Trajectory(self._T_world_cam.rows.copy(), self._numbers.rows.copy(), self._times.rows.copy())

    def state(self) -> dict[str, Any]:
        """The poses so far."""
        return to_state(vars(self.trajectory()) | {"vectors": self._vectors.rows})

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        kept = from_state(state)
        self._numbers, self._times = Growing(kept["numbers"]), Growing(kept["timestamps"])
        self._vectors, self._T_world_cam = Growing(kept["vectors"]), Growing(kept["T_world_cam"])

    def _predicted(self) -> CameraPose:
        *before, last = (CameraPose.of_vector(vector) for vector in self._vectors.rows[-2:].copy())
        return extrapolated(before[0], last) if before and self._config.constant_velocity else last

    def _optimised(self, frame: StereoFrame) -> tuple[CameraPose, int]:
        """The pose that the lowest loss led to, and how many pixels that loss was of."""
        c = self._config
        assert frame.depth is not None, "uses_depth gets it"
        depth = frame.depth.depth
        depth = np.where(depth <= c.max_depth_m, depth, np.nan)  # NaN stays NaN
        loss = TrackingLoss(frame.left, depth, c.silhouette, c.depth_weight, c.color_weight)
        optimizer = PoseOptimizer(c.rotation_rate, c.translation_rate)
        pose = best = self._predicted()
        lowest, pixels, steps, done = np.inf, 0, c.iterations, 0
        while done < steps:
            done += 1
            value, twist = self._map.differentiate(PinholeView.of(self._camera, pose.T_world_cam), loss)
            pose = optimizer.step(pose, pose.gradient(twist))
            if loss.pixels and value < lowest:
                lowest, pixels, best = value, loss.pixels, pose
            if done == c.iterations and 0 < c.retry_loss <= loss.depth_loss:
                steps = 2 * c.iterations
        return best, pixels
