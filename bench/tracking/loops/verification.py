"""Whether two places are the same by geometry, and the motion between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.geometry import se3
from bench.tracking.descriptors import Ints
from bench.tracking.loops.places import Place
from bench.tracking.matching import match_boxes
from bench.tracking.pose_optimization import (
    Observations,
    PoseEstimate,
    optimise_pose,
    pose_jacobian,
    projection_jacobian,
)
from bench.tracking.relocalise import match_descriptors, pose_by_pnp
from bench.types import Float, StereoCamera

_RATIO = 0.85
_LEAST_MATCHES = 15
_RADIUS_PX, _MAX_DISTANCE, _GUIDED_RATIO = 6.0, 64, 0.9
"""Of the matches around the first pose: search radius in pixels of the octave, greatest distance, Lowe's ratio."""
_NEAR_M = 0.5
_CELLS = (6, 3)
"""Columns and rows of the grid by which the spread of inliers is judged."""
_LEAST_CELLS = 5
_AGREEMENT_M, _AGREEMENT_DEG = 0.3, 1.0
"""By how much the poses old -> new and new -> old may differ."""
_INFLATION = 3.0
"""True errors of a verified pose against its formal sigma: points have errors of their own, and they are shared."""
_FLOOR_M, _FLOOR_RAD = 0.02, 0.001


@dataclass(frozen=True)
class Verified:
    """The pose ``T_old_new`` (4, 4) of the new camera in the old one's frame, with the covariance (6, 6) of the right
    perturbation T exp(rho, phi) in metres and radians, and the number of inliers."""

    T_old_new: Float
    covariance: Float
    inliers: int


def verify(camera: StereoCamera, old: Place, new: Place, min_inliers: int) -> Verified | None:
    """Match two places and find the pose between them; None unless both directions find it with enough inliers.

    PnP with RANSAC gives a first pose, around which more matches are found; then the new camera is fitted to the old
    camera's points and the old camera to the new one's, on their stereo measurements. The two must agree, and the
    inliers must not all lie in one corner of the image: a single repeated window is not a place.
    """
    at_old, at_new = match_descriptors(old.descriptors, new.descriptors, _RATIO)
    if len(at_old) < _LEAST_MATCHES:
        return None
    start = pose_by_pnp(camera, old.points(camera, at_old), new.observations(at_new).uv)
    if start is None:
        return None
    at_old, at_new = _match_around(camera, old, new, start)
    if len(at_old) < min_inliers:
        return None
    old_points, new_points = old.points(camera, at_old), new.points(camera, at_new)
    seen_by_new, seen_by_old = new.observations(at_new), old.observations(at_old)
    forward = optimise_pose(camera, old_points, seen_by_new, start)
    backward = optimise_pose(camera, new_points, seen_by_old, se3.inverse(forward.T_cam_world))
    inliers = forward.inliers & backward.inliers
    count = int(inliers.sum())
    if count < min_inliers or _cells(camera, seen_by_new.uv[inliers]) < _LEAST_CELLS:
        return None
    forward_T, backward_T = se3.inverse(forward.T_cam_world), backward.T_cam_world
    difference = se3.inverse(forward_T) @ backward_T
    if not close(difference, _AGREEMENT_M, _AGREEMENT_DEG):
        return None
    T_old_new = se3.orthonormalise(forward_T @ se3.exp(0.5 * se3.log(difference)))
    return Verified(T_old_new, _covariance(camera, forward, old_points, seen_by_new), count)


def _match_around(camera: StereoCamera, old: Place, new: Place, T_new_old: Float) -> tuple[Ints, Ints]:
    """Indices (M,), (M,) of keypoints of the two places that match where the pose says that they should."""
    points = old.points(camera, np.arange(len(old)))
    in_new = points @ T_new_old[:3, :3].T + T_new_old[:3, 3]
    ahead = np.flatnonzero(in_new[:, 2] > _NEAR_M)
    points, in_new = points[ahead], in_new[ahead]
    nearer = np.linalg.norm(points, axis=1) / np.linalg.norm(in_new, axis=1)
    octave = old.octave[ahead] + np.log(nearer) / np.log(old.scale_factor)
    at_old, at_new = match_boxes(
        in_new[:, :2] / in_new[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy),
        _RADIUS_PX * old.scale_factor ** np.maximum(octave, 0.0),
        octave,
        camera.fx * camera.baseline / in_new[:, 2],
        old.descriptors[ahead],
        new.features,
        new.disparity.astype(np.float64),
        _MAX_DISTANCE,
        _GUIDED_RATIO,
    )
    return ahead[at_old], at_new


def close(difference: Float, distance_m: float, angle_deg: float) -> bool:
    """Whether a motion (4, 4) is no longer and no wider than that."""
    short = np.linalg.norm(difference[:3, 3]) <= distance_m
    return bool(short and np.degrees(se3.rotation_angle(difference[:3, :3])) <= angle_deg)


def _cells(camera: StereoCamera, uv: Float) -> int:
    cell = np.floor(uv / (camera.width, camera.height) * _CELLS).astype(np.int64)
    return len(np.unique(cell[:, 1] * _CELLS[0] + cell[:, 0]))


def _covariance(camera: StereoCamera, estimate: PoseEstimate, points: Float, observed: Observations) -> Float:
    """Inverse of the Gauss-Newton matrix. A left step of T_new_old is a right step of T_old_new, but for its sign."""
    T = estimate.T_cam_world
    in_camera = points[estimate.inliers] @ T[:3, :3].T + T[:3, 3]
    used = observed.take(estimate.inliers)
    J = pose_jacobian(projection_jacobian(camera, in_camera, ~np.isnan(used.disparity)), in_camera).reshape(-1, 6)
    information = (J * np.repeat(used.weight, 3)[:, None]).T @ J
    floor = np.diag([_FLOOR_M**2] * 3 + [_FLOOR_RAD**2] * 3)
    return np.asarray(_INFLATION**2 * np.linalg.inv(information) + floor, dtype=np.float64)
