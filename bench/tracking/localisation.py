"""Pose of a frame from the local map: around a prediction, or from descriptors alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.geometry import se3
from bench.tracking.descriptors import Ints
from bench.tracking.local_map import LocalMap, View
from bench.tracking.matching import match_boxes
from bench.tracking.pose_optimization import Observations, PoseEstimate, chi_square, optimise_pose
from bench.tracking.relocalise import match_descriptors, pose_by_pnp
from bench.tracking.second_motion import SecondMotion
from bench.types import Float, Mask, StereoCamera

_WIDE_RADIUS, _NARROW_RADIUS = 12.0, 4.0
"""Search radii in pixels of the octave: around the predicted pose, and around the pose optimised once."""
_WIDE_SEARCHES = 5
_SETTLED_BASELINES, _SETTLED_DEG = 0.5, 1.0
"""After a search that moved the pose farther than this, near points were outside their radius: search again."""
_PROVEN_FRAMES = 3
"""Frames in which a map point must have agreed with the pose to be proven ..."""
_PROVEN_PX = 8.0
"""... while the camera moved past it by so many pixels of its octave, three gates: what drives along with the camera
would have left the gate by then ..."""
_PROVEN_AT_REST_FRAMES = 10
"""... or frames without that, for a camera at rest."""
_LEAST_PROVEN = 10
"""Matches of proven points that are enough to begin with."""
_MAX_DISTANCE = 80
_RATIO, _FALLBACK_RATIO = 0.85, 0.9
_DOUBTFUL_SHARE = 0.8
"""Where fewer of the matches than this are inliers, the prediction may have been wrong: on repeated facades a wrong
pose finds dozens of consistent matches (share 0.73 on a street, against 0.85 and more for right poses)."""
_REASSIGNED = 3
"""Rounds in which matches are given to the one or the other of two motions."""


@dataclass(frozen=True)
class Matches:
    """Rows of map points and keypoints (M,) that belong together, with the pose that they gave; ``proven`` (M,) are the
    points that have stood still for some frames. ``second`` is another motion that the image shows besides; the frames
    before did not where it ``begins``."""

    rows: Ints
    keypoints: Ints
    estimate: PoseEstimate
    proven: Mask
    second: PoseEstimate | None = None
    begins: bool = False

    @property
    def count(self) -> int:
        """Number of inliers."""
        return int(self.estimate.inliers.sum())

    def alone(self, other: Matches) -> tuple[int, int]:
        """Proven points, and points, that agree with this pose and not with the other: what to compare two poses by.

        Far points agree with both. Of the near ones those count that have stood still: a lorry's have not, however many
        they are, and after a jump all of them agree with the new place.
        """
        mine, theirs = self.estimate.inliers, other.estimate.inliers
        alone = ~np.isin(self.rows[mine], other.rows[theirs])
        return int((alone & self.proven[mine]).sum()), int(alone.sum())

    @property
    def doubtful(self) -> bool:
        """Whether so many matches contradict the pose that it may be another place that looks alike, or the image shows
        two motions, of which the wrong one may be believed."""
        return self.second is not None or self.count < _DOUBTFUL_SHARE * len(self.rows)


class Localiser:
    """Finds frames in a local map; ``min_inliers`` decides whether a frame counts as found."""

    def __init__(self, camera: StereoCamera, local_map: LocalMap, octaves: int, scale: float, min_inliers: int) -> None:
        self._camera = camera
        self._map = local_map
        self._octaves = octaves
        self._scale = scale
        self._min_inliers = min_inliers
        self._second = SecondMotion(camera, local_map, min_inliers)

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        return self._second.state()

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._second.restore(state)

    def locate(self, view: View, T_cam_world: Float, trusted: bool) -> Matches | None:
        """Pose around the prediction ``T_cam_world`` (4, 4), or from descriptors alone where that explains more of what
        is seen; None without enough inliers.

        Descriptors are asked only if the prediction fails, is not ``trusted``, its result is doubtful, or something
        moved by itself a few frames ago. Then a pose close to the prediction comes first, none is taken that goes on as
        the other motion did, and what moves by itself takes its matches out of the pose.
        """
        found = self._as_predicted(view, T_cam_world) if self._second.expected else None
        found = found or self._around(view, T_cam_world)
        if found is not None and trusted and not (found.doubtful or self._second.expected):
            return found
        matched = match_descriptors(self._map.points.descriptor, view.features.descriptors, _FALLBACK_RATIO)
        pose = self._pose_from_descriptors(view, *matched)
        other = None if pose is None else self._around(view, pose)
        if other is not None and self.drives(other.estimate.T_cam_world, T_cam_world):
            other = None
        if found is None or (other is not None and self._beats(other, found)):
            found = other
        if found is None:
            self._second.fade()
            return None
        believed, begins = found.rows[found.estimate.inliers], not self._second.expected
        second = self._second.find(view, matched, believed, found.estimate.T_cam_world)
        if second is not None:
            found = replace(self._without(view, found, second), second=second, begins=begins)
        return found if found.count >= self._min_inliers else None

    def drives(self, T_cam_world: Float, T_predicted: Float) -> bool:
        """Whether a pose (4, 4) goes on as what moved by itself a few frames ago, rather than as predicted."""
        return self._second.drives(T_cam_world, T_predicted)

    def _beats(self, other: Matches, found: Matches) -> bool:
        """Whether ``other``, of descriptors alone, is the better pose; where something moves by itself and little has
        stood still for long, it must also agree with more."""
        theirs, mine = other.alone(found), found.alone(other)
        return theirs > mine and (not self._second.expected or (theirs[0] > mine[0] and theirs[1] > mine[1]))

    def _without(self, view: View, matches: Matches, second: PoseEstimate) -> Matches:
        """The matches that the second motion does not explain better, with the pose that they give."""
        position, observed = self._map.points.position[matches.rows], view.observations(matches.keypoints)
        theirs = chi_square(self._camera, position, observed, second.T_cam_world)
        estimate = matches.estimate
        for _ in range(_REASSIGNED):
            mine = chi_square(self._camera, position, observed, estimate.T_cam_world) <= theirs
            estimate = self._optimised(position[mine], observed.take(mine), matches.proven[mine], estimate.T_cam_world)
        return Matches(matches.rows[mine], matches.keypoints[mine], estimate, matches.proven[mine])

    def _as_predicted(self, view: View, T_cam_world: Float) -> Matches | None:
        """Matches and pose close to ``T_cam_world``; None where a pose with enough inliers isn't there."""
        matches = self._match(view, T_cam_world, _NARROW_RADIUS)
        pose = matches.estimate.T_cam_world
        if matches.count < self._min_inliers or not self._settled(T_cam_world, pose):
            return None
        again = self._match(view, pose, _NARROW_RADIUS)
        return again if again.count >= self._min_inliers else None

    def _around(self, view: View, T_cam_world: Float) -> Matches | None:
        """Matches and pose around ``T_cam_world``, searched widely until the pose settles, then narrowly."""
        pose = T_cam_world
        for _ in range(_WIDE_SEARCHES):
            matches = self._match(view, pose, _WIDE_RADIUS)
            if matches.count < self._min_inliers:
                return None
            before, pose = pose, matches.estimate.T_cam_world
            if self._settled(before, pose):
                break
        matches = self._match(view, pose, _NARROW_RADIUS)
        return matches if matches.count >= self._min_inliers else None

    def _settled(self, before: Float, after: Float) -> bool:
        motion = after @ se3.inverse(before)
        moved = float(np.linalg.norm(motion[:3, 3])), np.degrees(float(se3.rotation_angle(motion[:3, :3])))
        return moved[0] < _SETTLED_BASELINES * self._camera.baseline and moved[1] < _SETTLED_DEG

    def _match(self, view: View, T: Float, radius: float) -> Matches:
        camera, points = self._camera, self._map.points
        in_camera = points.position @ T[:3, :3].T + T[:3, 3]
        z = np.maximum(in_camera[:, 2], 1e-6)
        uv = in_camera[:, :2] / z[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        in_view = (in_camera[:, 2] > 0.1) & ((uv >= 0) & (uv < (camera.width, camera.height))).all(axis=1)
        rows = np.flatnonzero(in_view)
        distance = np.sqrt((in_camera[rows] ** 2).sum(axis=1))
        octave = np.log(points.reach[rows] / distance) / np.log(self._scale)
        reach = radius * self._scale ** np.clip(octave, 0, self._octaves - 1)
        disparity = camera.fx * camera.baseline / z[rows]
        descriptors = points.descriptor[rows]
        query, keypoint = match_boxes(
            uv[rows], reach, octave, disparity, descriptors, view.features, view.disparity, _MAX_DISTANCE, _RATIO
        )
        rows = rows[query]
        proven = self._proven(rows, T, octave[query])
        estimate = self._optimised(points.position[rows], view.observations(keypoint), proven, T)
        return Matches(rows, keypoint, estimate, proven)

    def _proven(self, rows: Ints, T: Float, octave: Float) -> Mask:
        """Which map points (M,) have stood still for so long that nothing that moves could have passed for them."""
        points = self._map.points
        found = points.found[rows]
        proven = found >= _PROVEN_AT_REST_FRAMES
        asked = np.flatnonzero((found >= _PROVEN_FRAMES) & ~proven)
        position = points.position[rows[asked]]
        then = position - self._map.poses[points.born[rows[asked]], :3, 3]
        now = position + T[:3, :3].T @ T[:3, 3]
        sine = np.linalg.norm(np.cross(then, now), axis=1)
        sine /= np.linalg.norm(then, axis=1) * np.linalg.norm(now, axis=1)
        scale = self._scale ** np.clip(octave[asked], 0, self._octaves - 1)
        proven[asked] = self._camera.fx * sine >= _PROVEN_PX * scale
        return proven

    def _optimised(self, position: Float, observed: Observations, proven: Mask, T: Float) -> PoseEstimate:
        """Pose from matches; points that have stood still for some frames say which of the others may join in.

        A lorry alongside can fill more of the image than the street does, and its points agree with each other. Where
        something moved by itself a few frames ago, they must agree with ``T`` to begin with.
        """
        careful = self._second.expected
        if proven.sum() < _LEAST_PROVEN:
            return optimise_pose(self._camera, position, observed, T, gate_first=careful)
        first = optimise_pose(self._camera, position[proven], observed.take(proven), T, gate_first=careful)
        return optimise_pose(self._camera, position, observed, first.T_cam_world, gate_first=True)

    def _pose_from_descriptors(self, view: View, row: Ints, keypoint: Ints) -> Float | None:
        position = self._map.points.position[row]
        pose = pose_by_pnp(self._camera, position, view.features.xy[keypoint])
        if pose is None:
            return None
        # RANSAC's pose comes from three points; all that agree with it, and their disparities, say it much better.
        return optimise_pose(self._camera, position, view.observations(keypoint), pose).T_cam_world
