"""The robust pose of one frame against known points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench import _native
from bench.geometry import se3
from bench.types import Float, Mask, StereoCamera

_ROUNDS = 3
_ITERATIONS = 4
_NEAR_PLANE_M = 0.1
_CHI2_MONO, _CHI2_STEREO = 5.991, 7.815
"""95 % quantiles of chi-square: the gates of observations without and with disparity, as in the C++ core."""


@dataclass(frozen=True)
class Observations:
    """M measurements: ``uv`` (M, 2) pixels in the left image, ``disparity`` (M,) pixels or NaN, and ``weight`` (M,),
    the information 1 / sigma^2 in 1/px^2 (1 / scale^2 of the keypoint's octave)."""

    uv: Float
    disparity: Float
    weight: Float

    @property
    def table(self) -> Float:
        """(M, 4): u, v, disparity, weight."""
        return np.column_stack([self.uv, self.disparity, self.weight])

    def take(self, index: np.ndarray) -> Observations:
        """The observations at ``index`` (integers or booleans)."""
        return Observations(self.uv[index], self.disparity[index], self.weight[index])

    def inliers(self, squared: Float) -> Mask:
        """Which ``squared`` residuals (M,), of ``chi_square``, pass their gate."""
        return squared <= np.where(np.isnan(self.disparity), _CHI2_MONO, _CHI2_STEREO)


def camera_numbers(camera: StereoCamera) -> list[float]:
    """fx, fy, cx, cy in pixels and fx * baseline in pixels times metres, as the C++ core wants them."""
    return [camera.fx, camera.fy, camera.cx, camera.cy, camera.fx * camera.baseline]


def projection_jacobian(camera: StereoCamera, in_camera: Float, has_disparity: Mask) -> Float:
    """Derivative (M, 3, 3) of (uL, v, uR) by the point in the camera frame; third row 0 without disparity."""
    x, y, z_inverse = in_camera[:, 0], in_camera[:, 1], 1.0 / in_camera[:, 2]
    J = np.zeros((len(in_camera), 3, 3))
    J[:, 0, 0] = camera.fx * z_inverse
    J[:, 0, 2] = -camera.fx * x * z_inverse**2
    J[:, 1, 1] = camera.fy * z_inverse
    J[:, 1, 2] = -camera.fy * y * z_inverse**2
    J[:, 2, 0] = J[:, 0, 0] * has_disparity
    J[:, 2, 2] = (J[:, 0, 2] + camera.fx * camera.baseline * z_inverse**2) * has_disparity
    return J


def pose_jacobian(J_point: Float, in_camera: Float) -> Float:
    """Derivative (M, 3, 6) of the projection by ``xi`` in ``exp(xi) T_cam_world``, xi = (rho, phi), at xi = 0."""
    J = np.empty((len(in_camera), 3, 6))
    J[:, :, :3] = J_point
    J[:, :, 3:] = np.cross(in_camera[:, None, :], J_point)
    return J


def chi_square(camera: StereoCamera, points: Float, observed: Observations, T_cam_world: Float) -> Float:
    """Weighted squared residuals (M,) of (uL, v, uR), the third left out without disparity, of ``points`` (M, 3) in the
    world under a pose; infinite behind the camera."""
    in_camera = points @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
    z = np.where(in_camera[:, 2] > _NEAR_PLANE_M, in_camera[:, 2], np.nan)
    uv = in_camera[:, :2] / z[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    e = observed.uv - uv
    right = np.where(np.isnan(observed.disparity), 0.0, e[:, 0] - observed.disparity + camera.fx * camera.baseline / z)
    return np.nan_to_num(observed.weight * ((e**2).sum(axis=1) + right**2), nan=np.inf)


@dataclass(frozen=True)
class PoseEstimate:
    """Result of ``optimise_pose``: pose (4, 4), inliers (M,), RMS of their (uL, v) residual in pixels."""

    T_cam_world: Float
    inliers: Mask
    rms_px: float


def optimise_pose(
    camera: StereoCamera, points: Float, observed: Observations, T_cam_world: Float, gate_first: bool = False
) -> PoseEstimate:
    """Gauss-Newton over the pose of one frame, from ``T_cam_world`` (4, 4); ``points`` (M, 3) in the world stay fixed.

    Residuals are measured minus projected (uL, v, uR) in pixels; without disparity the third is left out. Paper, Eq.
    "frame-level BA". Rounds of iterations with Huber's loss; after each round the observations beyond the 95 % quantile
    of chi-square (5.991 without, 7.815 with disparity) are put aside (and may come back). The last round has no robust
    loss. With ``gate_first`` they are put aside from the beginning: for a start that is already good, where most
    observations may be wrong. Never fails: with too few inliers (the caller checks) the pose is whatever was found.
    """
    numbers = camera_numbers(camera)
    T, inliers, squared = _native.optimise_pose(
        numbers, points, observed.table, T_cam_world, _ROUNDS, _ITERATIONS, gate_first
    )
    inliers = inliers.astype(bool)
    count = int(inliers.sum())
    return PoseEstimate(se3.orthonormalise(T), inliers, float(np.sqrt(squared / count)) if count else float("nan"))
