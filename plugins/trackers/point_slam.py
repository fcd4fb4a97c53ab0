"""Point-SLAM's tracking: rays around the sensor's depth, rendered from the neural points."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from bench.baselines.point_slam.map_view import PointMapView
from bench.baselines.point_slam.radius import edges
from bench.baselines.point_slam.tracking import PointSlamTrackerConfig, Sight, search_pose, usable_pixels
from bench.contracts.dataset import Dataset
from bench.contracts.map_view import MapView
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.geometry import se3
from bench.registry import register
from bench.types import Event, Float, StereoFrame, TrackingResult, TrackingState, Trajectory

_SEED = 1219
"""The original's."""


@register("tracker", "point_slam", config=PointSlamTrackerConfig)
class PointSlamTracker(Tracker):
    """Point-SLAM's pose search from constant speed; its first two frames take the ground truth, as in the original.

    Works with mapper=point_slam only. Where the data set has no ground truth, the first frame is the world's origin
    and the second one is tracked from there, and the run says so.
    """

    uses_map = True
    uses_depth = True

    def __init__(self, config: PointSlamTrackerConfig) -> None:
        self._config = config
        self._view: PointMapView | None = None

    def start(self, dataset: Dataset) -> None:
        """Begin a new sequence with its camera, and its ground truth for the first frames."""
        self._camera, self._truth = dataset.camera, dataset.ground_truth()
        self._random = torch.Generator().manual_seed(_SEED)
        self._poses: list[Float] = []
        self._numbers: list[int] = []
        self._times: list[float] = []

    def use_map(self, view: MapView) -> None:
        """``BenchError`` for a map that is no cloud of neural points."""
        if not isinstance(view, PointMapView):
            raise BenchError(
                "tracker=point_slam renders rays around the sensor's depth, which mapper=point_slam alone can; choose "
                "that mapper, or another tracker."
            )
        self._view = view

    def track(self, frame: StereoFrame) -> TrackingResult:
        """The pose of least loss; "predicted" where no ray meets points, which leaves the guess of constant speed."""
        events: tuple[Event, ...] = ()
        state: TrackingState = "ok"
        position = len(self._poses)
        pose = self._true_pose(frame.number) if position < self._config.true_poses else None
        if pose is None and position == 0:
            pose = np.eye(4)
            events = (Event("warning", frame.number, {"text": _NO_TRUTH}),) if self._config.true_poses else ()
        if pose is None:
            pose, loss = self._search(frame)
            state = "ok" if np.isfinite(loss) else "predicted"
        self._poses.append(pose)
        self._numbers.append(frame.number)
        self._times.append(frame.timestamp)
        return TrackingResult(pose, state, events=events)

    def _true_pose(self, number: int) -> Float | None:
        return None if self._truth is None else self._truth.pose_of(number)

    def _search(self, frame: StereoFrame) -> tuple[Float, float]:
        assert self._view is not None, "use_map() comes before track()"
        assert frame.depth is not None
        view, edge, depth = self._view, edges(frame.left), self._view.usable(frame.depth.depth)
        sight = Sight(
            frame.left, depth, view.query_radius(edge, depth), usable_pixels(depth, edge, self._config, self._camera)
        )
        return search_pose(
            *(self._guess(), sight, self._camera, view.render_rays),
            *(view.settings, self._config, view.device, self._random),
        )

    def _guess(self) -> Float:
        """The last pose, moved as between the two before."""
        last = self._poses[-1]
        return last if len(self._poses) < 2 else last @ se3.inverse(self._poses[-2]) @ last

    def trajectory(self) -> Trajectory:
        """The poses as they were found."""
        poses = np.stack(self._poses) if self._poses else np.zeros((0, 4, 4))
        return Trajectory(poses, np.array(self._numbers, np.int64), np.array(self._times, np.float64))

    def state(self) -> dict[str, Any]:
        """Poses so far, and the random numbers to come."""
        poses = torch.from_numpy(self.trajectory().T_world_cam)
        numbers, times = list(self._numbers), list(self._times)
        return {"poses": poses, "numbers": numbers, "times": times, "random": self._random.get_state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._poses = list(state["poses"].numpy())
        self._numbers, self._times = list(state["numbers"]), list(state["times"])
        self._random.set_state(state["random"])


_NO_TRUTH = (
    "the data set has no ground truth for the first frames, which tracker=point_slam takes them from: the first is the "
    "world's origin, the second is tracked from there"
)
