"""Stereo projection with its Jacobians, and the robust pose of one frame against known points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.geometry import se3
from bench.types import Float, Mask, StereoCamera

CHI2_MONO = 5.991
"""95 % quantile of chi-square with 2 degrees of freedom: gate of an observation without disparity."""
CHI2_STEREO = 7.815
"""The same with 3 degrees of freedom: gate of an observation with disparity."""
_NEAR_PLANE = 0.1
_ROUNDS = 3
_ITERATIONS = 4


@dataclass(frozen=True)
class Observations:
    """M measurements: ``uv`` (M, 2) pixels in the left image, ``disparity`` (M,) pixels or NaN, and ``weight`` (M,),
    the information 1 / sigma^2 in 1/px^2 (1 / scale^2 of the keypoint's octave)."""

    uv: Float
    disparity: Float
    weight: Float

    @property
    def gate(self) -> Float:
        """Chi-square gate (M,) of each observation."""
        return np.where(np.isnan(self.disparity), CHI2_MONO, CHI2_STEREO)

    def take(self, index: np.ndarray) -> Observations:
        """The observations at ``index`` (integers or booleans)."""
        return Observations(self.uv[index], self.disparity[index], self.weight[index])


def residuals(camera: StereoCamera, in_camera: Float, observed: Observations) -> Float:
    """Measured minus projected (uL, v, uR), (M, 3) pixels; the third is 0 where there is no disparity.

    ``in_camera`` (M, 3) are the points in the left camera's frame, with z > 0. Paper, Eq. "frame-level BA".
    """
    z_inverse = 1.0 / in_camera[:, 2]
    out = np.empty((len(in_camera), 3))
    out[:, 0] = observed.uv[:, 0] - camera.fx * in_camera[:, 0] * z_inverse - camera.cx
    out[:, 1] = observed.uv[:, 1] - camera.fy * in_camera[:, 1] * z_inverse - camera.cy
    out[:, 2] = out[:, 0] - observed.disparity + camera.fx * camera.baseline * z_inverse
    out[np.isnan(observed.disparity), 2] = 0.0
    return out


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


def huber_weight(chi2: Float, gate: Float) -> Float:
    """Weight of iteratively reweighted least squares for Huber's loss with threshold sqrt(gate), by chi-square."""
    return np.sqrt(np.minimum(1.0, gate / np.maximum(chi2, 1e-12)))


@dataclass(frozen=True)
class PoseEstimate:
    """Result of ``optimise_pose``: pose (4, 4), inliers (M,), RMS of their (uL, v) residual in pixels."""

    T_cam_world: Float
    inliers: Mask
    rms_px: float


def optimise_pose(camera: StereoCamera, points: Float, observed: Observations, T_cam_world: Float) -> PoseEstimate:
    """Gauss-Newton over the pose of one frame, from ``T_cam_world`` (4, 4); ``points`` (M, 3) in the world stay fixed.

    Rounds of iterations with Huber's loss; after each round the observations beyond their chi-square gate are put aside
    (and may come back). The last round has no robust loss. Never fails: with too few inliers (the caller checks) the
    pose is whatever was found.
    """
    T = T_cam_world
    gate, has_disparity = observed.gate, ~np.isnan(observed.disparity)
    inliers = np.ones(len(points), dtype=bool)
    for round_number in range(_ROUNDS):
        robust = round_number < _ROUNDS - 1
        for _ in range(_ITERATIONS):
            step = _step(camera, points, observed, T, inliers, gate if robust else None, has_disparity)
            T = se3.exp(step) @ T
            if np.abs(step).max() < 1e-7:
                break
        chi2 = _chi2(camera, points, observed, T)
        inliers = chi2 <= gate
    T = se3.orthonormalise(T)
    return PoseEstimate(T, inliers, _rms(camera, points[inliers], observed.take(inliers), T))


def _step(
    camera: StereoCamera, points: Float, observed: Observations, T: Float, use: Mask, gate: Float | None, stereo: Mask
) -> Float:
    in_camera = points @ T[:3, :3].T + T[:3, 3]
    used = np.flatnonzero(use & (in_camera[:, 2] > _NEAR_PLANE))
    if len(used) < 3:
        return np.zeros(6)
    in_camera, observed = in_camera[used], observed.take(used)
    error = residuals(camera, in_camera, observed)
    weight = observed.weight
    if gate is not None:
        weight = weight * huber_weight(weight * (error**2).sum(1), gate[used])
    J = pose_jacobian(projection_jacobian(camera, in_camera, stereo[used]), in_camera).reshape(-1, 6)
    JW = J * np.repeat(weight, 3)[:, None]
    # A trace of damping keeps degenerate scenes (a handful of far points) solvable without moving well-posed ones.
    H = JW.T @ J
    H[np.diag_indices(6)] += 1e-6 * np.diag(H) + 1e-9
    step = np.linalg.solve(H, JW.T @ error.reshape(-1))
    return step / max(1.0, np.abs(step[3:]).max() / 0.5, np.abs(step[:3]).max() / 10.0)


def _chi2(camera: StereoCamera, points: Float, observed: Observations, T: Float) -> Float:
    in_camera = points @ T[:3, :3].T + T[:3, 3]
    behind = in_camera[:, 2] <= _NEAR_PLANE
    in_camera[behind, 2] = 1.0
    chi2 = observed.weight * (residuals(camera, in_camera, observed) ** 2).sum(1)
    chi2[behind] = np.inf
    return chi2


def _rms(camera: StereoCamera, points: Float, observed: Observations, T: Float) -> float:
    if len(points) == 0:
        return float("nan")
    error = residuals(camera, points @ T[:3, :3].T + T[:3, 3], observed)[:, :2]
    return float(np.sqrt((error**2).sum(1).mean()))
