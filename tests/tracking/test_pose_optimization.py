"""Jacobians against numerical differentiation, and the pose of a made-up frame against the pose that made it."""

from __future__ import annotations

import numpy as np
import pytest

from bench.geometry import se3
from bench.tracking.pose_optimization import (
    Observations,
    chi_square,
    optimise_pose,
    pose_jacobian,
    projection_jacobian,
)
from bench.types import StereoCamera

CAMERA = StereoCamera(1226, 370, 707.0, 705.0, 601.0, 183.0, (0.54, 0.0, 0.0))


def points_in_front(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    z = rng.uniform(4.0, 60.0, count)
    return np.column_stack([rng.uniform(-0.8, 0.8, count) * z, rng.uniform(-0.25, 0.25, count) * z, z])


def project(points: np.ndarray) -> np.ndarray:
    """(uL, v, uR) through two 3x4 projection matrices, as a text book has it; nothing of the code under test."""
    homogeneous = np.column_stack([points, np.ones(len(points))])
    left = homogeneous @ (CAMERA.intrinsics @ np.eye(4)[:3]).T
    right = homogeneous @ (CAMERA.intrinsics @ np.linalg.inv(CAMERA.T_left_right)[:3]).T
    return np.column_stack([left[:, :2] / left[:, 2:], right[:, 0] / right[:, 2]])


def observe(points: np.ndarray, T: np.ndarray, noise: float = 0.0) -> Observations:
    seen = project(points @ T[:3, :3].T + T[:3, 3])
    seen = seen + np.random.default_rng(5).normal(size=seen.shape) * noise
    return Observations(seen[:, :2], seen[:, 0] - seen[:, 2], np.ones(len(points)))


def test_point_jacobian_equals_central_differences() -> None:
    points, step = points_in_front(40), 1e-5
    numeric = np.stack([(project(points + step * e) - project(points - step * e)) / (2 * step) for e in np.eye(3)], 2)
    np.testing.assert_allclose(projection_jacobian(CAMERA, points, np.ones(40, bool)), numeric, rtol=1e-6, atol=1e-6)


def test_pose_jacobian_equals_central_differences() -> None:
    points, step = points_in_front(40), 1e-6

    def moved(xi: np.ndarray) -> np.ndarray:
        T = se3.exp(xi)
        return project(points @ T[:3, :3].T + T[:3, 3])

    numeric = np.stack([(moved(step * e) - moved(-step * e)) / (2 * step) for e in np.eye(6)], 2)
    J = pose_jacobian(projection_jacobian(CAMERA, points, np.ones(40, bool)), points)
    np.testing.assert_allclose(J, numeric, rtol=1e-5, atol=1e-5)


def test_chi_square_is_that_of_a_text_book() -> None:
    points, T = points_in_front(40), se3.exp([0.1, -0.05, 0.2, 0.01, 0.02, -0.01])
    seen = observe(points, np.eye(4), noise=1.0)
    observed = Observations(seen.uv, np.where(np.arange(40) < 20, np.nan, seen.disparity), np.linspace(0.2, 1, 40))
    error = np.column_stack([seen.uv, seen.uv[:, 0] - seen.disparity]) - project(points @ T[:3, :3].T + T[:3, 3])
    error[:20, 2] = 0
    squared = chi_square(CAMERA, points, observed, T)
    np.testing.assert_allclose(squared, observed.weight * (error**2).sum(axis=1))
    np.testing.assert_array_equal(observed.inliers(squared), squared <= np.where(np.arange(40) < 20, 5.991, 7.815))
    assert chi_square(CAMERA, -points[:1], seen.take(np.array([0])), T) == np.inf


def test_observations_without_disparity_have_no_third_row() -> None:
    assert not projection_jacobian(CAMERA, points_in_front(3), np.zeros(3, bool))[:, 2].any()


@pytest.mark.parametrize("mono", [False, True])
def test_pose_is_found_among_outliers(mono: bool) -> None:
    points, truth = points_in_front(300), se3.exp(np.array([0.3, -0.1, 1.2, 0.01, 0.03, -0.02]))
    observed = observe(points, truth)
    wrong = np.arange(300) < 90
    uv = observed.uv + wrong[:, None] * np.random.default_rng(1).uniform(15, 40, size=(300, 2))
    disparity = np.where(mono & (np.arange(300) % 2 == 0), np.nan, observed.disparity)
    found = optimise_pose(CAMERA, points, Observations(uv, disparity, observed.weight), np.eye(4))
    np.testing.assert_allclose(found.T_cam_world, truth, atol=1e-6)
    np.testing.assert_array_equal(found.inliers, ~wrong)
    assert found.rms_px < 1e-4


def test_noise_gives_errors_of_the_size_that_the_covariance_foretells() -> None:
    points, truth = points_in_front(400), se3.exp(np.array([0.1, 0.0, 1.0, 0.0, 0.01, 0.0]))
    found = optimise_pose(CAMERA, points, observe(points, truth, noise=0.5), se3.exp(np.full(6, 0.01)) @ truth)
    error = se3.log(found.T_cam_world @ se3.inverse(truth))
    # 400 points, 0.5 px: about 0.5 / 707 / sqrt(400) rad of rotation; allow four of those, and 2 cm.
    assert np.abs(error[3:]).max() < 4 * 0.5 / 707 / 20
    assert np.abs(error[:3]).max() < 0.02


def test_points_behind_the_camera_are_outliers() -> None:
    points = points_in_front(50)
    observed = observe(points, np.eye(4))
    points[:5, 2] *= -1
    found = optimise_pose(CAMERA, points, observed, np.eye(4))
    np.testing.assert_array_equal(found.inliers, np.arange(50) >= 5)


def test_nothing_to_see_leaves_the_pose() -> None:
    nothing = Observations(np.empty((0, 2)), np.empty(0), np.empty(0))
    found = optimise_pose(CAMERA, np.empty((0, 3)), nothing, np.eye(4))
    np.testing.assert_array_equal(found.T_cam_world, np.eye(4))
    assert np.isnan(found.rms_px)
