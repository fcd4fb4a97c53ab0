"""Parts of a system that tell what they were given, or answer wrongly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bench.contracts.loss import LossTerm
from bench.registry import register
from bench.types import Event, Keyframe, MappingReport, StereoCamera, StereoFrame, TrackingResult, Trajectory
from plugins.mappers.gaussian import GaussianMapper, GaussianMapperConfig
from plugins.trackers.groundtruth import GroundTruth, GroundTruthConfig


@register("mapper", "spy_for_tests", config=GaussianMapperConfig)
class SpyMapper(GaussianMapper):
    """The Gaussian mapper; notes the frames, the windows and the poses that reach it."""

    seen: list[tuple[int, tuple[int, ...]]]
    poses: list[Trajectory]
    finished: int

    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        super().start(camera, losses, seed)
        type(self).seen, type(self).poses, type(self).finished = [], [], 0

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        self.seen.append((keyframe.frame.number, tuple(window)))
        np.testing.assert_allclose(keyframe.T_world_cam, self.poses[-1].pose_of(keyframe.frame.number))
        return super().add_keyframe(keyframe, window)

    def update_poses(self, trajectory: Trajectory) -> None:
        self.poses.append(trajectory)
        super().update_poses(trajectory)

    def final_steps(self) -> Iterator[tuple[Event, ...]]:
        type(self).finished += 1
        yield from super().final_steps()


@dataclass(frozen=True)
class OddTrackerConfig(GroundTruthConfig):
    """``answer``: what it says in frame 1; ``lost_from`` it is lost; ``trajectory_fails``: it can't give its trajectory
    either."""

    answer: str = "lost"
    lost_from: int = 1000
    trajectory_fails: bool = False


@register("tracker", "odd_for_tests", config=OddTrackerConfig)
class OddTracker(GroundTruth):
    """Ground truth, but for frame 1."""

    def __init__(self, config: OddTrackerConfig) -> None:
        super().__init__(config)
        self._odd = config
        self._lost: list[int] = []

    def track(self, frame: StereoFrame) -> TrackingResult:
        result = super().track(frame)
        if frame.number != 1 and frame.number < self._odd.lost_from:
            return result
        if self._odd.answer == "lost" or frame.number >= self._odd.lost_from:
            self._lost.append(frame.number)
            return TrackingResult(None, "lost")
        if self._odd.answer == "raise":
            raise RuntimeError("the tracker broke")
        if self._odd.answer == "predicted":
            return TrackingResult(result.T_world_cam, "predicted")
        bad = {"nan": np.full((4, 4), np.nan), "3x4": np.eye(4)[:3], "none": None}[self._odd.answer]
        return TrackingResult(bad, "ok")

    def trajectory(self) -> Trajectory:
        if self._odd.trajectory_fails and self._lost_or_broken:
            raise RuntimeError("no trajectory either")
        known = super().trajectory()
        keep = ~np.isin(known.numbers, self._lost)
        return Trajectory(known.T_world_cam[keep], known.numbers[keep], known.timestamps[keep])

    @property
    def _lost_or_broken(self) -> bool:
        return self._odd.answer == "raise" and len(super().trajectory()) > 1
