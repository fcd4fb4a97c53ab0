"""Bundle adjustment of a made-up scene against the truth, a general least-squares solver, and GTSAM."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from bench.geometry import se3
from bench.tracking.local_ba import Problem, solve
from bench.tracking.pose_optimization import Observations
from bench.types import StereoCamera

CAMERA = StereoCamera(1226, 370, 707.0, 705.0, 601.0, 183.0, (0.54, 0.0, 0.0))


def project(points: np.ndarray) -> np.ndarray:
    z = points[:, 2]
    u = CAMERA.fx * points[:, 0] / z + CAMERA.cx
    return np.column_stack([u, CAMERA.fy * points[:, 1] / z + CAMERA.cy, u - CAMERA.fx * CAMERA.baseline / z])


def scene(
    keyframes: int, count: int, fixed: int, noise: float, seed: int = 0
) -> tuple[Problem, np.ndarray, np.ndarray]:
    """A car's drive past ``count`` points, each seen in about 70 % of the keyframes, a fifth without disparity."""
    rng = np.random.default_rng(0)
    motion = np.column_stack([rng.normal(size=(keyframes, 3)) * 0.02, rng.normal(size=(keyframes, 3)) * 0.01])
    motion[:, 2] = -np.arange(keyframes)
    T = se3.exp(motion)
    points = np.column_stack([rng.uniform(-8, 8, count), rng.uniform(-3, 2, count), rng.uniform(14, 40, count)])
    keyframe, point = np.nonzero(rng.random((keyframes, count)) < 0.7)
    seen = project((T[keyframe, :3, :3] @ points[point][:, :, None])[..., 0] + T[keyframe, :3, 3])
    seen += rng.normal(size=seen.shape) * noise
    disparity = np.where(rng.random(len(seen)) < 0.2, np.nan, seen[:, 0] - seen[:, 2])
    observed = Observations(seen[:, :2], disparity, rng.uniform(0.3, 1.0, len(seen)))
    guess_T, guess_points = T.copy(), points + rng.normal(size=points.shape) * 0.1
    guess_T[fixed:] = se3.exp(rng.normal(size=(keyframes - fixed, 6)) * 0.005) @ T[fixed:]
    return Problem(guess_T, fixed, guess_points, keyframe, point, observed), T, points


def robust_cost(
    problem: Problem, T_cam_world: np.ndarray, points: np.ndarray, which: np.ndarray | slice = slice(None)
) -> float:
    """Huber's loss of the observations' chi-square, summed, by projection."""
    k, p, observed = problem.keyframe[which], problem.point[which], problem.observed.take(which)
    seen = project((T_cam_world[k, :3, :3] @ points[p][:, :, None])[..., 0] + T_cam_world[k, :3, 3])
    error = seen - np.column_stack([observed.uv, observed.uv[:, 0] - observed.disparity])
    gate = np.where(np.isnan(error[:, 2]), 5.991, 7.815)
    chi2 = observed.weight * np.nansum(error**2, axis=1)
    return float(np.where(chi2 <= gate, chi2, 2 * np.sqrt(gate * chi2) - gate).sum())


def test_noiseless_scene_comes_back_exactly() -> None:
    problem, T, points = scene(keyframes=6, count=150, fixed=2, noise=0.0)
    solution = solve(CAMERA, problem, iterations=(8, 8))
    np.testing.assert_allclose(solution.T_cam_world, T, atol=1e-6)
    well_seen = np.bincount(problem.point) >= 3
    np.testing.assert_allclose(solution.points[well_seen], points[well_seen], atol=1e-3)
    np.testing.assert_array_equal(solution.T_cam_world[:2], problem.T_cam_world[:2])
    assert solution.inliers.all()


def test_minimum_equals_that_of_a_general_solver() -> None:
    problem, _, _ = scene(keyframes=4, count=18, fixed=1, noise=0.3)
    free = 3
    root = np.sqrt(problem.observed.weight)

    def cost(x: np.ndarray) -> np.ndarray:
        T = problem.T_cam_world.copy()
        T[1:] = se3.exp(x[: 6 * free].reshape(free, 6)) @ T[1:]
        points = x[6 * free :].reshape(-1, 3)
        k, p = problem.keyframe, problem.point
        error = project((T[k, :3, :3] @ points[p][:, :, None])[..., 0] + T[k, :3, 3])
        error[:, :2] -= problem.observed.uv
        error[:, 2] -= problem.observed.uv[:, 0] - problem.observed.disparity
        error[np.isnan(error)] = 0.0
        return (error * root[:, None]).ravel()

    start = np.concatenate([np.zeros(6 * free), problem.points.ravel()])
    oracle = least_squares(cost, start, method="trf", x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    ours = solve(CAMERA, problem, iterations=(20,))
    assert ours.inliers.all(), "no observation may be gated here, or the two solve different problems"
    expected = se3.exp(oracle.x[: 6 * free].reshape(free, 6)) @ problem.T_cam_world[1:]
    # Ours stops when a step gains less than 1e-4 of the cost; the noise itself moves the poses by centimetres.
    np.testing.assert_allclose(ours.T_cam_world[1:], expected, atol=2e-4)
    assert robust_cost(problem, ours.T_cam_world, ours.points) <= 2 * oracle.cost * (1 + 2e-4)


def test_wrong_observations_are_found_and_do_no_harm() -> None:
    problem, T, _ = scene(keyframes=6, count=200, fixed=2, noise=0.1)
    wrong = np.random.default_rng(9).random(len(problem.point)) < 0.08
    uv = problem.observed.uv + wrong[:, None] * 25.0
    bad = Problem(
        problem.T_cam_world,
        2,
        problem.points,
        problem.keyframe,
        problem.point,
        Observations(uv, problem.observed.disparity, problem.observed.weight),
    )
    solution = solve(CAMERA, bad, iterations=(8, 8))
    assert np.abs(se3.log(solution.T_cam_world @ se3.inverse(T))[:, :3]).max() < 0.02
    assert (~solution.inliers[wrong]).mean() > 0.9
    assert solution.inliers[~wrong].mean() > 0.97
    before = robust_cost(bad, bad.T_cam_world, bad.points)
    assert robust_cost(bad, solution.T_cam_world, solution.points) < before


def test_minimum_equals_that_of_gtsam() -> None:
    """GTSAM's Levenberg-Marquardt on the same problem, stereo and mono factors; no observation beyond its gate, so that
    Huber's loss is the square."""
    gtsam = pytest.importorskip("gtsam", reason="gtsam is the oracle of this test: pip install gtsam")
    problem, _, _ = scene(keyframes=8, count=120, fixed=3, noise=0.2)
    ours = solve(CAMERA, problem, iterations=(30,))
    assert ours.inliers.all()
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    stereo = gtsam.Cal3_S2Stereo(CAMERA.fx, CAMERA.fy, 0.0, CAMERA.cx, CAMERA.cy, CAMERA.baseline)
    mono = gtsam.Cal3_S2(CAMERA.fx, CAMERA.fy, 0.0, CAMERA.cx, CAMERA.cy)
    for k, T in enumerate(problem.T_cam_world):
        start.insert(gtsam.symbol("x", k), gtsam.Pose3(np.linalg.inv(T)))
        if k < problem.fixed:
            graph.add(gtsam.NonlinearEqualityPose3(gtsam.symbol("x", k), gtsam.Pose3(np.linalg.inv(T))))
    for p in np.unique(problem.point):
        start.insert(gtsam.symbol("l", int(p)), problem.points[p])
    observed = problem.observed
    for k, p, uv, d, w in zip(
        problem.keyframe, problem.point, observed.uv, observed.disparity, observed.weight, strict=True
    ):
        keys = (gtsam.symbol("x", int(k)), gtsam.symbol("l", int(p)))
        if np.isnan(d):
            noise = gtsam.noiseModel.Isotropic.Precision(2, w)
            graph.add(gtsam.GenericProjectionFactorCal3_S2(gtsam.Point2(*uv), noise, *keys, mono))
        else:
            noise = gtsam.noiseModel.Isotropic.Precision(3, w)
            measured = gtsam.StereoPoint2(uv[0], uv[0] - d, uv[1])
            graph.add(gtsam.GenericStereoFactor3D(measured, noise, *keys, stereo))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    best = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
    expected = np.array([np.linalg.inv(best.atPose3(gtsam.symbol("x", k)).matrix()) for k in range(8)])
    # Ours stops when a step gains less than 1e-4 of the cost; the noise itself moves the poses by centimetres.
    np.testing.assert_allclose(ours.T_cam_world, expected, atol=3e-4)
    assert robust_cost(problem, ours.T_cam_world, ours.points) <= 2 * graph.error(best) * (1 + 2e-4)


def test_gradient_vanishes_at_the_minimum() -> None:
    """Central differences of the robust cost, worked with two projection matrices, by every pose parameter."""
    problem, _, _ = scene(keyframes=5, count=150, fixed=1, noise=0.3)
    wrong = np.random.default_rng(3).random(len(problem.point)) < 0.03
    uv = problem.observed.uv + wrong[:, None] * 4.0
    observed = Observations(uv, problem.observed.disparity, problem.observed.weight)
    problem = Problem(problem.T_cam_world, 1, problem.points, problem.keyframe, problem.point, observed)
    solution = problem
    for _ in range(8):  # every call stops at 1e-4 of the cost; together they converge
        found = solve(CAMERA, solution, iterations=(10,))
        solution = Problem(found.T_cam_world, 1, found.points, problem.keyframe, problem.point, observed)

    def cost(k: int, xi: np.ndarray) -> float:
        T = solution.T_cam_world.copy()
        T[k] = se3.exp(xi) @ T[k]
        return robust_cost(solution, T, solution.points, problem.keyframe == k)

    for k in range(1, 5):
        for step in 1e-4 * np.eye(6):
            slope = (cost(k, step) - cost(k, -step)) / 2
            bend = cost(k, step) - 2 * cost(k, 0 * step) + cost(k, -step)
            # Newton's step along this parameter: below 1e-6 m or radians.
            assert abs(slope / bend) * 1e-4 < 1e-6


def test_same_problem_gives_the_same_bits() -> None:
    problem, _, _ = scene(keyframes=6, count=150, fixed=2, noise=0.3)
    first, second = solve(CAMERA, problem), solve(CAMERA, problem)
    np.testing.assert_array_equal(first.T_cam_world, second.T_cam_world)
    np.testing.assert_array_equal(first.points, second.points)


def test_points_behind_the_camera_and_points_seen_once_do_no_harm() -> None:
    problem, T, _ = scene(keyframes=6, count=150, fixed=2, noise=0.1)
    points = problem.points.copy()
    points[:5, 2] = -20.0
    keep = np.ones(len(problem.point), dtype=bool)
    keep[np.flatnonzero(problem.point == 7)[1:]] = False
    bad = Problem(
        problem.T_cam_world, 2, points, problem.keyframe[keep], problem.point[keep], problem.observed.take(keep)
    )
    solution = solve(CAMERA, bad, iterations=(8, 8))
    assert np.isfinite(solution.points).all()
    assert np.abs(se3.log(solution.T_cam_world @ se3.inverse(T))[:, :3]).max() < 0.02
