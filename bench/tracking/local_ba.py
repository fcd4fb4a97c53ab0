"""Bundle adjustment over a window of keyframes and the points they see, by the Schur complement."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.geometry import se3
from bench.tracking.features import Ints
from bench.tracking.pose_optimization import (
    Observations,
    huber_weight,
    pose_jacobian,
    projection_jacobian,
    residuals,
)
from bench.types import Float, Mask, StereoCamera

_NEAR_PLANE = 0.1


@dataclass(frozen=True)
class Problem:
    """K keyframe poses ``T_cam_world`` (K, 4, 4), the first ``fixed`` of them held; P ``points`` (P, 3); M observations
    of point ``point[m]`` in keyframe ``keyframe[m]``, sorted by keyframe, at most one of a point in each."""

    T_cam_world: Float
    fixed: int
    points: Float
    keyframe: Ints
    point: Ints
    observed: Observations

    @cached_property
    def blocks(self) -> list[slice]:
        """Where in the observations each keyframe's lie."""
        edges = np.searchsorted(self.keyframe, np.arange(len(self.T_cam_world) + 1))
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]


@dataclass(frozen=True)
class Solution:
    """Optimised poses (K, 4, 4) and points (P, 3); ``inliers`` (M,) pass their chi-square gate; robust costs of before
    and after, in chi-square units."""

    T_cam_world: Float
    points: Float
    inliers: Mask
    cost_before: float
    cost_after: float


def solve(camera: StereoCamera, problem: Problem, iterations: tuple[int, ...] = (3, 3)) -> Solution:
    """Levenberg-Marquardt with Huber's loss; paper, Eq. "local BA" (window and gates as in ORB-SLAM2, 2017).

    Each entry of ``iterations`` is a round; after it, observations beyond their gate are left out of the next one.
    Points that end up with a single mono observation keep their place through the damping. Poses with index below
    ``fixed`` come back unchanged. A step that raises the cost is undone, so the cost never grows within a round.
    """
    T, points = problem.T_cam_world.copy(), problem.points.copy()
    use = np.ones(len(problem.point), dtype=bool)
    gate = problem.observed.gate
    chi2 = _chi2(camera, problem, T, points)
    before = _robust_cost(chi2, gate)
    for count in iterations:
        T, points = _round(camera, problem, T, points, use, count)
        chi2 = _chi2(camera, problem, T, points)
        use = chi2 <= gate
    return Solution(T, points, use, before, _robust_cost(chi2, gate))


def _round(
    camera: StereoCamera, problem: Problem, T: Float, points: Float, use: Mask, iterations: int
) -> tuple[Float, Float]:
    chosen = np.flatnonzero(use)
    keyframe, point, observed = problem.keyframe[chosen], problem.point[chosen], problem.observed.take(chosen)
    gate = observed.gate
    part = Problem(T, problem.fixed, points, keyframe, point, observed)
    damping = 1e-5
    cost = _robust_cost(_chi2(camera, part, T, points), gate)
    for _ in range(iterations):
        pose_step, point_step = _step(camera, part, T, points, gate, damping)
        T_new = T.copy()
        T_new[problem.fixed :] = se3.exp(pose_step) @ T[problem.fixed :]
        points_new = points + point_step
        cost_new = _robust_cost(_chi2(camera, part, T_new, points_new), gate)
        if cost_new < cost:
            converged = cost - cost_new < 1e-4 * cost
            T, points, cost, damping = T_new, points_new, cost_new, damping * 0.1
            if converged:
                break
        else:
            damping *= 100.0
    T = T.copy()
    T[problem.fixed :] = se3.orthonormalise(T[problem.fixed :])
    return T, points


def _step(
    camera: StereoCamera, problem: Problem, T: Float, points: Float, gate: Float, damping: float
) -> tuple[Float, Float]:
    """Damped normal equations, reduced to the poses: steps (K - fixed, 6) and (P, 3)."""
    observed, point = problem.observed, problem.point
    count, poses = len(points), len(T) - problem.fixed
    in_camera = _transform(T, points, problem)
    in_front = in_camera[:, 2] > _NEAR_PLANE
    in_camera[~in_front, 2] = 1.0
    error = residuals(camera, in_camera, observed)
    weight = observed.weight * huber_weight(observed.weight * (error**2).sum(1), gate) * in_front
    J_camera = projection_jacobian(camera, in_camera, ~np.isnan(observed.disparity))
    J_point = np.empty_like(J_camera)
    for k, mine in enumerate(problem.blocks):
        J_point[mine] = J_camera[mine] @ T[k, :3, :3]
    WJ_point = J_point * weight[:, None, None]
    H_point = _sum_by(point, np.einsum("mri,mrj->mij", WJ_point, J_point), count)
    np.einsum("nii->ni", H_point)[:] *= 1.0 + damping
    np.einsum("nii->ni", H_point)[:] += 1e-6
    root = _inverse_root(H_point)
    g_point = _sum_by(point, np.einsum("mri,mr->mi", WJ_point, error), count)
    g_white = np.einsum("nji,nj->ni", root, g_point).reshape(-1)

    # The coupling of poses and points as one dense matrix, whitened by the points: 10 poses by a few thousand points
    # are some hundred thousand numbers, and one product of it with its transpose beats any walk over the pairs of
    # observations of a point.
    coupling = np.zeros((poses, 6, count, 3))
    H_pose, g_pose = np.zeros((6 * poses, 6 * poses)), np.zeros(6 * poses)
    for k, mine in enumerate(problem.blocks[problem.fixed :]):
        J = pose_jacobian(J_camera[mine], in_camera[mine])
        WJ = J * weight[mine, None, None]
        block = slice(6 * k, 6 * k + 6)
        H_pose[block, block] = WJ.reshape(-1, 6).T @ J.reshape(-1, 6)
        g_pose[block] = WJ.reshape(-1, 6).T @ error[mine].reshape(-1)
        mixed = np.einsum("mri,mrj->mij", WJ, J_point[mine]) @ root[point[mine]]
        coupling[k][:, point[mine]] = np.swapaxes(mixed, 0, 1)
    H_pose[np.diag_indices(6 * poses)] += damping * np.diag(H_pose) + 1e-6
    B = coupling.reshape(6 * poses, 3 * count)
    pose_step = np.linalg.solve(H_pose - B @ B.T, g_pose - B @ g_white)
    white_step = (g_white - pose_step @ B).reshape(count, 3)
    return np.asarray(pose_step, dtype=np.float64).reshape(poses, 6), np.einsum("nij,nj->ni", root, white_step)


def _transform(T: Float, points: Float, problem: Problem) -> Float:
    out = points[problem.point]
    for k, mine in enumerate(problem.blocks):
        out[mine] = out[mine] @ T[k, :3, :3].T + T[k, :3, 3]
    return out


def _chi2(camera: StereoCamera, problem: Problem, T: Float, points: Float) -> Float:
    in_camera = _transform(T, points, problem)
    behind = in_camera[:, 2] <= _NEAR_PLANE
    in_camera[behind, 2] = 1.0
    chi2 = problem.observed.weight * (residuals(camera, in_camera, problem.observed) ** 2).sum(1)
    chi2[behind] = 1e6
    return chi2


def _robust_cost(chi2: Float, gate: Float) -> float:
    return float(np.where(chi2 <= gate, chi2, 2.0 * np.sqrt(gate * chi2) - gate).sum())


def _sum_by(group: Ints, values: Float, groups: int) -> Float:
    """Sum of ``values`` (M, ...) by ``group`` (M,) into (groups, ...)."""
    columns = values.reshape(len(values), -1).T
    out = np.empty((groups, len(columns)))
    for i, column in enumerate(columns):
        out[:, i] = np.bincount(group, weights=column, minlength=groups)
    return out.reshape(groups, *values.shape[1:])


def _inverse_root(A: Float) -> Float:
    """Upper triangular R (N, 3, 3) with R R^T = A^-1, of symmetric positive definite A, by Cholesky written out."""
    tiny = 1e-12
    l00 = np.sqrt(np.maximum(A[:, 0, 0], tiny))
    l10, l20 = A[:, 1, 0] / l00, A[:, 2, 0] / l00
    l11 = np.sqrt(np.maximum(A[:, 1, 1] - l10 * l10, tiny))
    l21 = (A[:, 2, 1] - l20 * l10) / l11
    l22 = np.sqrt(np.maximum(A[:, 2, 2] - l20 * l20 - l21 * l21, tiny))
    R = np.zeros_like(A)
    R[:, 0, 0], R[:, 1, 1], R[:, 2, 2] = 1.0 / l00, 1.0 / l11, 1.0 / l22
    R[:, 0, 1] = -l10 * R[:, 0, 0] * R[:, 1, 1]
    R[:, 1, 2] = -l21 * R[:, 1, 1] * R[:, 2, 2]
    R[:, 0, 2] = -(l20 * R[:, 0, 0] + l21 * R[:, 0, 1]) * R[:, 2, 2]
    return R
