"""The pose graph on a square whose answer is known by hand, and among false loops that break least squares."""

from __future__ import annotations

import builtins
from typing import Any

import numpy as np
import pytest
import torch  # noqa: F401 - before gtsam, as in the bench

from bench.errors import BenchError
from bench.geometry import se3
from bench.tracking.loops import pose_graph
from bench.tracking.loops.pose_graph import Edge, Graph, adjoint, condensed, integrated, optimise

gtsam = pytest.importorskip("gtsam")


def around_a_square(side: int) -> np.ndarray:
    """Steps (4 side, 4, 4) of 1 m along a square and back to its start, a right turn at the end of each side."""
    step = np.eye(4)
    step[2, 3] = 1.0
    turn = step.copy()
    turn[:3, :3] = se3.so3_exp(np.array([0.0, np.pi / 2, 0.0]))
    return np.stack([turn if (k + 1) % side == 0 else step for k in range(4 * side)])


def test_a_square_shares_its_misclosure_equally() -> None:
    """With firm rotations the problem is linear: each of K steps with variance s^2 takes the share s^2 / (K s^2 + r^2)
    of the misclosure, in world axes, and the loop with variance r^2 keeps the rest."""
    true_steps = around_a_square(5)
    K, s, r = 20, 0.1, 0.2
    measured = true_steps.copy()
    measured[:, :3, 3] += np.random.default_rng(0).normal(0, 0.05, (K, 3))
    drifted = integrated(measured)
    misclosure = drifted[-1, :3, 3]
    loop = Edge(0, K, np.eye(4), np.diag([r**2] * 3 + [1e-14] * 3))
    poses, believed = optimise(Graph(measured, np.tile([s, 1e-7], (K, 1)), [loop]), drifted)
    share = np.arange(K + 1)[:, None] * s**2 / (K * s**2 + r**2)
    assert believed.tolist() == [True]
    assert np.abs(poses[:, :3, 3] - (drifted[:, :3, 3] - share * misclosure)).max() < 1e-5
    assert np.abs(poses[:, :3, :3] - drifted[:, :3, :3]).max() < 1e-5
    assert np.array_equal(poses[0], drifted[0])


def circle(K: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """True poses of 1.2 rounds on a circle at 1 m a step, and drifting steps between them."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2.4 * np.pi, K)
    T = np.tile(np.eye(4), (K, 1, 1))
    T[:, :3, :3] = se3.so3_exp(np.column_stack([0 * angle, angle, 0 * angle]))
    radius = K / (2.4 * np.pi)
    T[:, 0, 3], T[:, 2, 3] = radius * (1 - np.cos(angle)), radius * np.sin(angle)
    noise = se3.exp(rng.normal(0, [0.01] * 3 + [0.0005] * 3, (K - 1, 6)))
    return T, se3.inverse(T[:-1]) @ T[1:] @ noise


def loops(truth: np.ndarray, good: int, bad: int, seed: int) -> list[Edge]:
    rng = np.random.default_rng(seed)
    K, covariance = len(truth), np.diag([0.08**2] * 3 + [0.003**2] * 3)
    pairs = [(10 + j, int(K / 1.2) + 5 + j) for j in range(good)]
    edges = [
        Edge(i, k, se3.inverse(truth[i]) @ truth[k] @ se3.exp(rng.normal(0, [0.05] * 3 + [0.002] * 3)), covariance)
        for i, k in pairs
    ]
    for _ in range(bad):
        i, k = sorted(int(x) for x in rng.choice(K, 2, replace=False))
        edges.append(Edge(i, k, se3.exp(rng.normal(0, [1.0] * 3 + [0.02] * 3)), covariance))
    return edges


def rms(poses: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(((poses - truth)[:, :3, 3] ** 2).sum(axis=1).mean()))


def plain_least_squares(steps: np.ndarray, edges: list[Edge], start: np.ndarray) -> np.ndarray:
    """gtsam's Levenberg-Marquardt on the whole graph, every loop believed."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(start[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    for k, T in enumerate(start):
        values.insert(k, gtsam.Pose3(T))
    for k, T in enumerate(steps):
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.0005] * 3 + [0.01] * 3))
        graph.add(gtsam.BetweenFactorPose3(k, k + 1, gtsam.Pose3(T), noise))
    for edge in edges:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.003] * 3 + [0.08] * 3))
        graph.add(gtsam.BetweenFactorPose3(edge.first, edge.second, gtsam.Pose3(edge.T_first_second), noise))
    solution = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
    return np.stack([solution.atPose3(k).matrix() for k in range(len(start))])


def test_with_true_loops_only_it_is_the_plain_least_squares_optimum() -> None:
    truth, steps = circle(300, 1)
    edges, start = loops(truth, 8, 0, 2), integrated(steps)
    poses, believed = optimise(Graph(steps, np.tile([0.01, 0.0005], (299, 1)), edges), start)
    assert believed.all()
    assert np.abs(poses - plain_least_squares(steps, edges, start)).max() < 1e-4


@pytest.mark.parametrize(("good", "bad"), [(6, 0), (6, 6), (0, 4)])
def test_loops_are_weighted_as_by_gtsams_own_optimizer(good: int, bad: int) -> None:
    truth, steps = circle(120, 9)
    edges, start, odometry = loops(truth, good, bad, 10), gtsam.Values(), gtsam.NonlinearFactorGraph()
    odometry.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(np.eye(4)), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    for k, T in enumerate(integrated(steps)):
        start.insert(k, gtsam.Pose3(T))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.0005] * 3 + [0.01] * 3))
    for k, T in enumerate(steps):
        odometry.add(gtsam.BetweenFactorPose3(k, k + 1, gtsam.Pose3(T), noise))
    weights, poses = pose_graph._graduated(gtsam, odometry, start, edges)

    whole = gtsam.NonlinearFactorGraph(odometry)
    for edge in edges:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.003] * 3 + [0.08] * 3))
        whole.add(gtsam.BetweenFactorPose3(edge.first, edge.second, gtsam.Pose3(edge.T_first_second), noise))
    parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
    parameters.setKnownInliers(list(range(len(truth))))
    # Weights of loops that are far off begin below gtsam's tolerance of 1e-4: it would call them 0 and stop at once.
    parameters.setWeightsTol(1e-12)
    theirs = gtsam.GncLMOptimizer(whole, start, parameters)
    theirs.setInlierCostThresholdsAtProbability(0.99)
    wanted = theirs.optimize()
    np.testing.assert_allclose(weights, np.asarray(theirs.getWeights())[len(truth) :], atol=1e-9)
    for k in range(len(truth)):
        np.testing.assert_allclose(poses.atPose3(k).matrix(), wanted.atPose3(k).matrix(), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_false_loops_are_found_out_where_least_squares_breaks(seed: int) -> None:
    truth, steps = circle(600, seed)
    edges, start = loops(truth, 10, 20, seed + 10), integrated(steps)
    poses, believed = optimise(Graph(steps, np.tile([0.01, 0.0005], (599, 1)), edges), start)
    assert believed.tolist() == [True] * 10 + [False] * 20
    assert rms(poses, truth) < 3.0
    assert rms(plain_least_squares(steps, edges, start), truth) > 10.0


def test_false_loops_alone_change_nothing_and_twice_the_same_is_the_same() -> None:
    truth, steps = circle(200, 3)
    start, sigma = integrated(steps), np.tile([0.01, 0.0005], (199, 1))
    poses, believed = optimise(Graph(steps, sigma, loops(truth, 0, 5, 4)), start)
    assert not believed.any()
    assert np.array_equal(poses, start)
    edges = loops(truth, 5, 5, 5)
    first, again = (optimise(Graph(steps, sigma, edges), start)[0] for _ in range(2))
    assert np.array_equal(first, again)


def test_adjoint_carries_a_motion_across() -> None:
    rng = np.random.default_rng(6)
    T, xi = se3.exp(rng.normal(0, 1, (5, 6))), rng.normal(0, 0.5, (5, 6))
    carried = (adjoint(T) @ xi[..., None])[..., 0]
    assert np.abs(T @ se3.exp(xi) - se3.exp(carried) @ T).max() < 1e-12


def test_condensed_odometry_has_the_covariance_of_its_steps() -> None:
    """Against central differences of each chain's end by every one of its steps."""
    _, steps = circle(13, 7)
    sigma = np.random.default_rng(8).uniform(0.01, 0.1, (12, 2))
    nodes = np.array([0, 1, 5, 12])
    chain, covariance = condensed(Graph(steps, sigma, []), nodes)

    def end(first: int, last: int, k: int = -1, xi: np.ndarray | None = None) -> np.ndarray:
        T = np.eye(4)
        for j in range(first, last):
            T = T @ steps[j] @ (se3.exp(xi) if j == k and xi is not None else np.eye(4))
        return T

    for c, (first, last) in enumerate(((0, 1), (1, 5), (5, 12))):
        assert np.abs(chain[c] - end(first, last)).max() < 1e-12
        expected = np.zeros((6, 6))
        for k in range(first, last):
            J = np.empty((6, 6))
            for axis in range(6):
                xi = np.zeros(6)
                xi[axis] = 1e-5
                ends = [se3.log(se3.inverse(chain[c]) @ end(first, last, k, sign * xi)) for sign in (1, -1)]
                J[:, axis] = (ends[0] - ends[1]) / 2e-5
            expected += J @ np.diag(np.repeat(sigma[k] ** 2, 3)) @ J.T
        assert np.abs(covariance[c] - expected).max() < 1e-8


def test_without_gtsam_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def no_gtsam(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "gtsam":
            raise ImportError("No module named 'gtsam'")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", no_gtsam)
    with pytest.raises(BenchError, match=r"pip install gtsam.*tracker\.loop_closure=false"):
        optimise(Graph(np.empty((0, 4, 4)), np.empty((0, 2)), []), np.eye(4)[None])
