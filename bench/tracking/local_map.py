"""The map of the last few keyframes: their observations, the points they see, and the points' upkeep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.geometry import se3
from bench.io.torch_files import from_state, to_state
from bench.tracking.descriptors import Descriptors, Ints, as_they_were
from bench.tracking.features import Features
from bench.tracking.growing import Growing
from bench.tracking.local_ba import Problem, Solution
from bench.tracking.pose_optimization import Observations
from bench.types import Float, StereoCamera

NO_POINT = -1
_PROBATION = 3
"""Keyframes after which a point must have been seen by at least two of them."""
_MIN_FOUND_RATIO = 0.25


@dataclass(frozen=True)
class View:
    """What one frame saw: its features, their disparities (N,) in pixels or NaN, and weights (N,) 1 / sigma^2.

    Disparities below ``least_disparity`` place new points but are no measurements: a bias of 0.05 pixels, which no
    stereo calibration is free of, is a percent of the depth there and would stretch the whole trajectory.
    """

    features: Features
    disparity: Float
    weight: Float
    least_disparity: float

    def observations(self, keypoint: Ints) -> Observations:
        """The measurements of the given keypoints; disparities below ``least_disparity`` count as unknown."""
        disparity = self.disparity[keypoint]
        disparity = np.where(disparity < self.least_disparity, np.nan, disparity)
        return Observations(self.features.xy[keypoint], disparity, self.weight[keypoint])


@dataclass
class KeyframeRecord:
    """A keyframe of the tracker's own (not the mapper's): ``point_ids`` (N,) names the map point of each keypoint.

    ``begins_map`` is True for the first keyframe of a local map: no observations tie its pose to the keyframe before.
    """

    index: int
    T_cam_world: Float
    view: View
    point_ids: Ints
    begins_map: bool


@dataclass
class Points:
    """P map points: ``ids`` (P,) ascending, ``position`` (P, 3) metres in the world, newest ``descriptor`` (P, W),
    ``reach`` (P,) metres (the distance at which the point would appear in octave 0), keyframe index of birth ``born``
    and of the last sighting ``seen`` (P,), and counts of frames where it was matched (``visible``) and where the match
    was an inlier (``found``)."""

    ids: Ints
    position: Float
    descriptor: Descriptors
    reach: Float
    born: Ints
    seen: Ints
    visible: Ints
    found: Ints

    def keep(self, mask: np.ndarray) -> None:
        """Forget the points where ``mask`` (P,) is False."""
        for name, values in vars(self).items():
            setattr(self, name, values[mask])

    def append(self, other: Points) -> None:
        """Add points whose ids are all above the present ones."""
        for name, values in vars(self).items():
            setattr(self, name, np.concatenate([values, getattr(other, name)]))


class LocalMap:
    """Keyframes and points of the recent past; older ones are forgotten, so size and time per frame stay bounded.

    Poses of forgotten keyframes stay in ``poses`` (T_world_cam by keyframe index), because frames hang on them.
    """

    def __init__(self, camera: StereoCamera, free_keyframes: int, fixed_keyframes: int, scale_factor: float) -> None:
        self._camera = camera
        self._free = free_keyframes
        self._fixed = fixed_keyframes
        self._scale_factor = scale_factor
        self._next_id = 0
        self._poses = Growing(np.empty((0, 4, 4)))
        self._moved_from = 0
        self.keyframes: list[KeyframeRecord] = []
        self.points = self._no_points()

    @property
    def poses(self) -> Float:
        """T_world_cam (K, 4, 4) of all keyframes ever, as known now; a view that the next keyframe makes stale."""
        return self._poses.rows

    def moved_from(self) -> int:
        """Index from which on poses may have changed since this was asked last."""
        first, self._moved_from = self._moved_from, len(self._poses)
        return first

    @staticmethod
    def _no_points() -> Points:
        none = np.empty(0, dtype=np.int64)
        return Points(none, np.empty((0, 3)), np.empty((0, 4), np.uint64), np.empty(0), none, none, none, none)

    def restart(self) -> None:
        """Forget keyframes and points (after a loss); ids and keyframe indices go on counting."""
        self.keyframes = []
        self.points = self._no_points()

    def rows(self, ids: Ints) -> Ints:
        """Row of each id (N,) in ``points``, -1 for ids that are not (or no longer) there."""
        if len(self.points.ids) == 0:
            return np.full(len(ids), -1)
        place = np.minimum(np.searchsorted(self.points.ids, ids), len(self.points.ids) - 1)
        return np.where(self.points.ids[place] == ids, place, -1)

    def add_keyframe(self, view: View, T_cam_world: Float, point_ids: Ints, max_depth: float) -> None:
        """Make the frame a keyframe; keypoints nearer than ``max_depth`` metres without a map point found new ones."""
        index = len(self._poses)
        self._poses.append(se3.inverse(T_cam_world))
        point_ids = point_ids.copy()
        if not len(self.points.ids):
            self.points.descriptor = view.features.descriptors[:0]  # the first view says of which kind they are
        rows = self.rows(point_ids)
        known = np.flatnonzero(rows >= 0)
        self.points.descriptor[rows[known]] = view.features.descriptors[known]
        self.points.seen[rows[known]] = index
        self._renew_reach(rows[known], view.features.octave[known], T_cam_world)

        with np.errstate(divide="ignore", invalid="ignore"):
            depth = self._camera.fx * self._camera.baseline / view.disparity
            new = np.flatnonzero((rows < 0) & (depth < max_depth))
        point_ids[rows < 0] = NO_POINT
        point_ids[new] = self._found(view, new, depth[new], T_cam_world, index)
        self.keyframes.append(KeyframeRecord(index, T_cam_world, view, point_ids, begins_map=not self.keyframes))

    def _found(self, view: View, keypoint: Ints, depth: Float, T_cam_world: Float, index: int) -> Ints:
        camera, T_world_cam = self._camera, se3.inverse(T_cam_world)
        ray = (view.features.xy[keypoint] - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        in_camera = np.column_stack([ray, np.ones(len(ray))]) * depth[:, None]
        ids = self._next_id + np.arange(len(keypoint))
        self._next_id += len(keypoint)
        at = np.full(len(ids), index)
        one = np.ones(len(ids), dtype=np.int64)
        self.points.append(
            Points(
                ids,
                in_camera @ T_world_cam[:3, :3].T + T_world_cam[:3, 3],
                view.features.descriptors[keypoint],
                np.linalg.norm(in_camera, axis=1) * self._scale_factor ** view.features.octave[keypoint],
                at,
                at.copy(),
                one,
                one.copy(),
            )
        )
        return ids

    def _renew_reach(self, rows: Ints, octave: Ints, T_cam_world: Float) -> None:
        in_camera = self.points.position[rows] @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
        self.points.reach[rows] = np.linalg.norm(in_camera, axis=1) * self._scale_factor**octave

    def problem(self) -> tuple[Problem, Ints, list[tuple[KeyframeRecord, Ints]]]:
        """Bundle adjustment of the newest keyframes: problem, rows of its points, and the keypoints that it uses.

        The oldest keyframe of a map is never free: it holds the world in place. Points with one observation are left
        out: they can't say anything about the poses.
        """
        window = self.keyframes[-(self._free + self._fixed) :]
        fixed = max(len(window) - self._free, 1)
        located = [self.rows(k.point_ids) for k in window]
        times_seen = np.bincount(np.concatenate(located) + 1, minlength=len(self.points.ids) + 1)[1:]
        moving = np.zeros(len(self.points.ids) + 1, dtype=bool)
        for rows in located[fixed:]:
            moving[rows] = True
        moving = moving[:-1] & (times_seen >= 2)
        chosen = np.flatnonzero(moving)
        number = np.full(len(moving) + 1, -1)
        number[chosen] = np.arange(len(chosen))
        sources = []
        for record, rows in zip(window, located, strict=True):
            sources.append((record, np.flatnonzero((rows >= 0) & (number[rows] >= 0))))
        point = np.concatenate([number[rows[s]] for rows, (_, s) in zip(located, sources, strict=True)])
        keyframe = np.concatenate([np.full(len(s), k) for k, (_, s) in enumerate(sources)])
        parts = [record.view.observations(s) for record, s in sources]
        observed = Observations(
            np.concatenate([p.uv for p in parts]),
            np.concatenate([p.disparity for p in parts]),
            np.concatenate([p.weight for p in parts]),
        )
        T = np.stack([k.T_cam_world for k in window])
        problem = Problem(T, fixed, self.points.position[chosen], keyframe, point, observed)
        return problem, chosen, sources

    def accept(
        self, problem: Problem, solution: Solution, rows: Ints, sources: list[tuple[KeyframeRecord, Ints]]
    ) -> None:
        """Write a solution of ``problem()`` back: poses, points, and the observations that it found wrong."""
        self.points.position[rows] = solution.points
        for k, (record, keypoints) in enumerate(sources):
            if k >= problem.fixed:
                record.T_cam_world = solution.T_cam_world[k]
                self.poses[record.index] = se3.inverse(record.T_cam_world)
                self._moved_from = min(self._moved_from, record.index)
            record.point_ids[keypoints[~solution.inliers[problem.blocks[k]]]] = NO_POINT

    def correct(self, poses: Float) -> None:
        """Take over T_world_cam (K, 4, 4) of all keyframes ever; points move with the keyframe that saw them last."""
        motion = poses @ se3.inverse(self.poses)
        moved = motion[self.points.seen]
        self.points.position = (moved[:, :3, :3] @ self.points.position[:, :, None])[..., 0] + moved[:, :3, 3]
        self.poses[:], self._moved_from = poses, 0
        for record in self.keyframes:
            record.T_cam_world = se3.inverse(poses[record.index])

    def cull(self) -> None:
        """Forget keyframes that left the window, and points that are out of sight, seldom found, or seen only once."""
        self.keyframes = self.keyframes[-(self._free + self._fixed) :]
        newest = self.keyframes[-1].index
        points = self.points
        all_ids = np.concatenate([k.point_ids for k in self.keyframes])
        rows = self.rows(all_ids[all_ids >= 0])
        sightings = np.bincount(rows[rows >= 0], minlength=len(points.ids))
        keep = points.seen > newest - self._free
        keep &= points.found >= _MIN_FOUND_RATIO * points.visible
        keep &= (sightings >= 2) | (points.born > newest - _PROBATION)
        points.keep(keep)

    def state(self) -> dict[str, Any]:
        """For a checkpoint: poses, keyframes with what they saw, points."""
        return {
            "next_id": self._next_id,
            **to_state({"poses": self.poses}),
            "keyframes": [_state_of(record) for record in self.keyframes],
            "points": to_state(vars(self.points)),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._next_id = state["next_id"]
        self._poses, self._moved_from = Growing(state["poses"].numpy()), 0
        self.keyframes = [_record_of(record) for record in state["keyframes"]]
        self.points = Points(**_described(from_state(state["points"]), "descriptor"))


def _state_of(record: KeyframeRecord) -> dict[str, Any]:
    view = {key: value for key, value in vars(record.view).items() if key != "features"}
    own = {key: value for key, value in vars(record).items() if key != "view"}
    return {"own": to_state(own), "view": to_state(view), "features": to_state(vars(record.view.features))}


def _record_of(state: dict[str, Any]) -> KeyframeRecord:
    features = Features(**_described(from_state(state["features"]), "descriptors"))
    return KeyframeRecord(view=View(features, **from_state(state["view"])), **from_state(state["own"]))


def _described(arrays: dict[str, Any], key: str) -> dict[str, Any]:
    return arrays | {key: as_they_were(arrays[key])}
