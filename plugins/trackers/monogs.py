"""MonoGS's tracking (RGB-D): the camera that makes the map's render equal to the image and the depth."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from bench.baselines.monogs.cameras import CameraAdam, moved
from bench.baselines.monogs.images import TrackingLoss, edge_mask, not_black
from bench.contracts.dataset import Dataset
from bench.contracts.map_view import MapView
from bench.contracts.tracker import Tracker
from bench.errors import BenchError, require_between, require_choice, require_least
from bench.geometry import se3
from bench.registry import PluginConfig, register
from bench.types import Float, PinholeView, StereoCamera, StereoFrame, TrackingResult, Trajectory

_STARTS = ("previous", "constant_velocity")


@dataclass(frozen=True)
class MonoGSTrackerConfig(PluginConfig):
    """Settings of MonoGS's tracking; the defaults are those for Replica."""

    iterations: int = 100
    """Steps of a frame at most."""
    stop_below: float = 1e-4
    """A step whose twist (metres and radians) is shorter than this is the last one."""
    translation_rate: float = 0.001
    """Adam's rate of translations, in metres a step."""
    rotation_rate: float = 0.003
    """Adam's rate of rotations, in radians a step."""
    exposure_rate: float = 0.01
    """Adam's rate of the two numbers of a frame's exposure."""
    start: str = "previous"
    """Where a frame begins: previous (at the pose of the frame before) or constant_velocity (at that, moved on as far
    as from the one before it)."""
    color_share: float = 0.95
    """Weight of the colours in the loss; the depth has the rest."""
    edge_threshold: float = 4.0
    """Colours count where the grey image changes by more than so many times the median change."""
    edge_blocks: bool = True
    """Whether that is the median of each of 32 x 32 blocks, else of the whole image."""
    max_depth_m: float = field(default=float("inf"), metadata={"infinite": True})
    """Depth beyond this counts as unknown."""

    def __post_init__(self) -> None:
        rates = ("stop_below", "translation_rate", "rotation_rate", "exposure_rate", "edge_threshold")
        require_least("tracker", self, iterations=1, **dict.fromkeys(rates, 0))
        require_between("tracker", self, 0, 1, "color_share")
        require_choice("tracker.start", self.start, _STARTS)
        if not self.max_depth_m > 0:
            raise BenchError(f"tracker.max_depth_m={self.max_depth_m} must be above 0 metres (inf: no limit).")


@register("tracker", "monogs", config=MonoGSTrackerConfig)
class MonoGSTracker(Tracker):
    """MonoGS (Matsuki et al., 2024), RGB-D: pose and exposure by Adam on the map's render, with the analytic gradient.

    The first frame has the identity as its pose (the original takes the ground truth). The weight by opacity is
    none that the pose can make smaller: no gradient goes through it. Where the mapper refines poses, frames begin at,
    and the trajectory has, the refined poses of keyframes; other frames keep the pose that was tracked.
    """

    uses_map = True
    uses_depth = True

    def __init__(self, config: MonoGSTrackerConfig) -> None:
        self.config = config

    @property
    def reach_m(self) -> float:
        """A step of Adam moves at most about its rate along each axis."""
        return self.config.iterations * self.config.translation_rate

    def start(self, dataset: Dataset) -> None:
        self._camera: StereoCamera = dataset.camera
        self._numbers: list[int] = []
        self._times: list[float] = []
        self._poses: list[Float] = []

    def use_map(self, view: MapView) -> None:
        view.require_images()
        self._map = view

    def track(self, frame: StereoFrame) -> TrackingResult:
        """Pose and exposure of this frame; "predicted" where the map shows nothing of it."""
        pose, exposure, sees = self._start_pose(), (0.0, 0.0), True
        if self._poses:
            pose, exposure, sees = self._align(frame, pose)
        self._numbers.append(frame.number)
        self._times.append(frame.timestamp)
        self._poses.append(pose)
        return TrackingResult(pose, "ok" if sees else "predicted", exposure=exposure)

    def _align(self, frame: StereoFrame, pose: Float) -> tuple[Float, tuple[float, float], bool]:
        """Pose (4, 4) and exposure from ``pose`` on, and whether the render had anything to do with the frame."""
        c = self.config
        if frame.depth is None:
            raise BenchError(f"tracker=monogs needs depth, and frame {frame.number} has none. Choose a stereo plugin.")
        mask = not_black(frame.left) & edge_mask(frame.left, c.edge_threshold, c.edge_blocks)
        with np.errstate(invalid="ignore"):
            depth = np.where(frame.depth.depth <= c.max_depth_m, frame.depth.depth, 0.0).astype(np.float32)
        loss = TrackingLoss(frame.left, depth, mask, c.color_share)
        adam = CameraAdam(c.translation_rate, c.rotation_rate, c.exposure_rate)
        view, value = PinholeView.of(self._camera, pose), 0.0
        for _ in range(c.iterations):
            value, by_twist = self._map.differentiate(view, loss)
            twist, change = adam.step(by_twist, loss.by_exposure)
            loss.exposure = (loss.exposure[0] + change[0], loss.exposure[1] + change[1])
            view = replace(view, T_world_cam=moved(view.T_world_cam, twist))
            if np.linalg.norm(twist) < c.stop_below:
                break
        return se3.orthonormalise(view.T_world_cam), loss.exposure, value > 0

    def _start_pose(self) -> Float:
        if not self._poses:
            return np.eye(4)
        last = self._pose(-1)
        if self.config.start == "previous" or len(self._poses) < 2:
            return last
        return se3.orthonormalise(last @ se3.inverse(self._pose(-2)) @ last)

    def _pose(self, place: int) -> Float:
        """As it is known now."""
        refined = self._map.refined_pose(self._numbers[place])
        return self._poses[place] if refined is None else refined

    def trajectory(self) -> Trajectory:
        poses = [self._pose(place) for place in range(len(self._poses))]
        stacked = np.stack(poses) if poses else np.zeros((0, 4, 4))
        return Trajectory(stacked, np.array(self._numbers, np.int64), np.array(self._times))

    def state(self) -> dict[str, Any]:
        """The frames' poses as they were tracked; refined ones are the mapper's."""
        poses = np.stack(self._poses) if self._poses else np.zeros((0, 4, 4))
        return {"numbers": list(self._numbers), "times": list(self._times), "poses": torch.from_numpy(poses)}

    def restore(self, state: dict[str, Any]) -> None:
        self._numbers, self._times = list(state["numbers"]), list(state["times"])
        self._poses = list(state["poses"].numpy())
