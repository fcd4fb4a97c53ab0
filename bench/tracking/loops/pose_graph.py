"""Poses of all keyframes that fit the odometry between neighbours and the loops, whatever loops are false."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from bench.errors import BenchError
from bench.geometry import se3
from bench.tracking.descriptors import Ints
from bench.types import Float, Mask

_INLIER_COST = 0.5 * 16.811893829770927
"""A loop is believed up to this cost: half the 99 % quantile of chi-square with six degrees of freedom."""
_LEAST_MU, _MU_STEP, _MOST_ROUNDS, _COST_SHARE = 1e-6, 1.4, 100, 1e-5
"""Of graduated non-convexity, as gtsam has them: it ends when the cost changes by less than this share."""
_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
"""gtsam's tangent vectors are (rotation, translation), ours (translation, rotation)."""
_ANCHOR_SIGMA = 1e-6


@dataclass(frozen=True)
class Edge:
    """Measured pose ``T_first_second`` (4, 4) of keyframe ``second`` in the frame of keyframe ``first``, with the
    covariance (6, 6) of its right perturbation T exp(rho, phi), in metres and radians."""

    first: int
    second: int
    T_first_second: Float
    covariance: Float


@dataclass(frozen=True)
class Graph:
    """``T_step`` (K - 1, 4, 4): odometry from each keyframe to the next, with sigmas (K - 1, 2) in metres and radians;
    ``loops``: edges that may be false."""

    T_step: Float
    sigma: Float
    loops: Sequence[Edge]


def optimise(graph: Graph, T_world_keyframe: Float) -> tuple[Float, Mask]:
    """Corrected poses (K, 4, 4), the first one unchanged, and which loops (L,) were believed; starts at the given ones.

    Graduated non-convexity with truncated least squares (Yang, Antonante, Tzoumas and Carlone, RA-L 2020) tells true
    loops from false ones. It runs on the keyframes that loops touch, with the odometry between them put together: the
    same optimum, in a hundredth of the time. Levenberg-Marquardt with the true loops then moves all. Raises
    ``BenchError`` without gtsam.
    """
    gtsam = import_gtsam()
    ends = np.array([(loop.first, loop.second) for loop in graph.loops], dtype=np.int64).reshape(-1, 2)
    nodes = np.unique(np.append(ends, 0))
    chain, covariance = condensed(graph, nodes)
    small, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    _anchor(gtsam, small, T_world_keyframe[0])
    for i, node in enumerate(nodes):
        start.insert(i, gtsam.Pose3(T_world_keyframe[node]))
    for i, (T, sigma2) in enumerate(zip(chain, covariance, strict=True)):
        small.add(gtsam.BetweenFactorPose3(i, i + 1, gtsam.Pose3(T), _gaussian(gtsam, sigma2)))
    at_ends = [
        replace(loop, first=int(first), second=int(second))
        for loop, (first, second) in zip(graph.loops, np.searchsorted(nodes, ends), strict=True)
    ]
    weights, solution = _graduated(gtsam, small, start, at_ends)
    believed = weights > 0.5
    if not believed.any():
        return T_world_keyframe.copy(), believed
    at_nodes = np.stack([solution.atPose3(i).matrix() for i in range(len(nodes))])
    poses = _all_poses(gtsam, graph, believed, _stretched(graph, nodes, at_nodes))
    poses[0] = T_world_keyframe[0]  # held in place to 1e-12; this makes it exact
    return poses, believed


def _graduated(gtsam: ModuleType, odometry: Any, start: Any, loops: Sequence[Edge]) -> tuple[Float, Any]:
    """Weights (L,) of the loops, 0 to 1, and the poses that minimise the squares weighted so, from ``start``.

    As gtsam's ``GncOptimizer``, which minimises anew from ``start`` for each ``mu``: here one Gauss-Newton step from
    the poses of the last ``mu`` follows them as well, in a quarter of the time.
    """
    full = [_between(gtsam, loop, loop.first, loop.second) for loop in loops]
    measured = [gtsam.Pose3(loop.T_first_second) for loop in loops]
    spread = np.array([loop.covariance for loop in loops]).reshape(-1, 6, 6)[:, _ROTATION_FIRST][:, :, _ROTATION_FIRST]

    def weighted(weights: Float) -> Any:
        """The odometry and the loops with their weights (L,)."""
        factors = gtsam.NonlinearFactorGraph(odometry)
        for loop, factor, T, covariance, weight in zip(loops, full, measured, spread, weights.tolist(), strict=True):
            if 0.0 < weight < 1.0:
                noise = gtsam.noiseModel.Gaussian.Covariance(covariance / weight)
                factors.add(gtsam.BetweenFactorPose3(loop.first, loop.second, T, noise))
            elif weight == 1.0:
                factors.add(factor)
        return factors

    whole = weighted(np.ones(len(loops)))
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(whole)
    first = gtsam.LevenbergMarquardtOptimizer(whole, start, gtsam.LevenbergMarquardtParams())
    poses, cost, weights = first.optimize(), first.error(), np.ones(len(loops))
    limit, beyond = _INLIER_COST, 2.0 * _costs(full, start) - _INLIER_COST
    if not (beyond > 0).any():
        return weights, poses
    mu = max(limit / float(beyond.max()), _LEAST_MU)
    for _ in range(_MOST_ROUNDS):
        costs = np.maximum(_costs(full, poses), 1e-300)
        weights = np.sqrt(limit * mu * (mu + 1.0) / costs) - mu
        weights[costs >= (mu + 1.0) / mu * limit] = 0.0
        weights[costs <= mu / (mu + 1.0) * limit] = 1.0
        now = weighted(weights)
        poses = poses.retract(now.linearize(poses).optimize(ordering))
        before, cost = cost, now.error(poses)
        if abs(cost - before) < _COST_SHARE * max(before, 1e-7) or np.isin(weights, (0.0, 1.0)).all():
            break
        mu *= _MU_STEP
    last = gtsam.LevenbergMarquardtOptimizer(weighted(weights), start, gtsam.LevenbergMarquardtParams())
    return weights, last.optimize()


def _costs(factors: Sequence[Any], poses: Any) -> Float:
    """Half the squared error (L,) of each factor, in sigmas."""
    return np.array([factor.error(poses) for factor in factors])


def _all_poses(gtsam: ModuleType, graph: Graph, believed: Mask, start_poses: Float) -> Float:
    factors, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    _anchor(gtsam, factors, start_poses[0])
    for k, T in enumerate(start_poses):
        start.insert(k, gtsam.Pose3(T))
    models = {}
    for k, (T, sigma) in enumerate(zip(graph.T_step, graph.sigma.tolist(), strict=True)):
        key = (sigma[0], sigma[1])
        if key not in models:
            models[key] = gtsam.noiseModel.Diagonal.Sigmas(np.repeat(sigma[::-1], 3))
        factors.add(gtsam.BetweenFactorPose3(k, k + 1, gtsam.Pose3(T), models[key]))
    for loop, good in zip(graph.loops, believed, strict=True):
        if good:
            factors.add(_between(gtsam, loop, loop.first, loop.second))
    solution = gtsam.LevenbergMarquardtOptimizer(factors, start, gtsam.LevenbergMarquardtParams()).optimize()
    poses = np.stack([solution.atPose3(k).matrix() for k in range(len(start_poses))])
    return se3.orthonormalise(poses)


def condensed(graph: Graph, nodes: Ints) -> tuple[Float, Float]:
    """Odometry between successive ``nodes`` (n,): motions (n - 1, 4, 4) and covariances (n - 1, 6, 6).

    Errors of the steps add up, each carried to the end of its chain by the adjoint of the motion that follows it.
    """
    T_first = integrated(graph.T_step)
    last = np.searchsorted(nodes, np.arange(1, nodes[-1] + 1))
    steps = np.arange(nodes[-1])
    A = adjoint(se3.inverse(T_first[nodes[last]]) @ T_first[steps + 1])
    sigma = np.repeat(graph.sigma[steps], 3, axis=1)
    spread = (A * sigma[:, None, :] ** 2) @ np.swapaxes(A, 1, 2)
    chains = se3.inverse(T_first[nodes[:-1]]) @ T_first[nodes[1:]]
    return chains, np.add.reduceat(spread, nodes[:-1], axis=0) if len(nodes) > 1 else spread


def integrated(T_step: Float) -> Float:
    """Poses (K, 4, 4) in the frame of the first one, from steps (K - 1, 4, 4)."""
    poses = np.empty((len(T_step) + 1, 4, 4))
    poses[0] = np.eye(4)
    for k, step in enumerate(T_step):
        poses[k + 1] = poses[k] @ step
    return poses


def adjoint(T: Float) -> Float:
    """Ad (..., 6, 6) of motions (..., 4, 4): T exp(xi) = exp(Ad xi) T, xi = (rho, phi) (Sola et al., 2018, Eq. 175)."""
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = T[..., :3, :3]
    out[..., :3, 3:] = se3.skew(T[..., :3, 3]) @ T[..., :3, :3]
    return out


def _stretched(graph: Graph, nodes: Ints, at_nodes: Float) -> Float:
    """Poses of all keyframes from those of the nodes: each hangs rigidly on the last node before it."""
    T_first = integrated(graph.T_step)
    owner = np.searchsorted(nodes, np.arange(len(T_first)), side="right") - 1
    return at_nodes[owner] @ se3.inverse(T_first[nodes[owner]]) @ T_first


def _anchor(gtsam: ModuleType, factors: object, T: Float) -> None:
    noise = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(T), noise))  # type: ignore[attr-defined]


def _between(gtsam: ModuleType, edge: Edge, first: int, second: int) -> object:
    T = gtsam.Pose3(edge.T_first_second)
    return gtsam.BetweenFactorPose3(first, second, T, _gaussian(gtsam, edge.covariance))


def _gaussian(gtsam: ModuleType, covariance: Float) -> object:
    return gtsam.noiseModel.Gaussian.Covariance(covariance[np.ix_(_ROTATION_FIRST, _ROTATION_FIRST)])


def import_gtsam() -> ModuleType:
    """The module gtsam; ``BenchError`` if it isn't installed."""
    try:
        import gtsam
    except ImportError as error:
        raise BenchError(
            f"Loop closing needs gtsam, which can't be imported ({error}). Install it with `pip install gtsam`, or "
            "switch loop closing off with tracker.loop_closure=false."
        ) from error
    return gtsam
