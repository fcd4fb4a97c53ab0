"""Bundle adjustment of a made-up scene against the truth, and against a general least-squares solver."""

from __future__ import annotations

import numpy as np
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
    assert ours.cost_after <= 2 * oracle.cost * (1 + 2e-4)


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
    assert solution.cost_after < solution.cost_before
