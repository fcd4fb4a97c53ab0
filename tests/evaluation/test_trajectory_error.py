"""ATE: cases worked by hand, evo as an independent oracle, and real ORB-SLAM2 trajectories with published values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.evaluation.trajectory import absolute_trajectory_error, static_camera_metrics, umeyama
from bench.types import Trajectory


def trajectory(centres: np.ndarray, numbers: np.ndarray | None = None) -> Trajectory:
    T = np.tile(np.eye(4), (len(centres), 1, 1))
    T[:, :3, 3] = centres
    numbers = np.arange(len(centres)) if numbers is None else numbers
    return Trajectory(T, numbers, numbers.astype(np.float64))


def rotation_about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def saddle() -> tuple[np.ndarray, np.ndarray]:
    """Eight points in a plane; the inner four of the estimate lifted by +-0.4 so that no rotation or shift helps."""
    signs = np.array([(x, y) for x in (1, -1) for y in (1, -1)], dtype=float)
    truth = np.zeros((8, 3))
    truth[:4, :2], truth[4:, :2] = signs, 2 * signs
    estimate = truth.copy()
    estimate[:4, 2] = 0.4 * np.sign(signs[:, 0] * signs[:, 1])
    return estimate, truth


def kitti_poses(path: Path) -> np.ndarray:
    T = np.tile(np.eye(4), (len(path.read_text().splitlines()), 1, 1))
    T[:, :3] = np.loadtxt(path).reshape(-1, 3, 4)
    return T


def test_saddle_has_the_errors_worked_by_hand() -> None:
    estimate, truth = saddle()
    result = absolute_trajectory_error(trajectory(estimate), trajectory(truth), "se3")
    assert not isinstance(result, str)
    assert result.rmse_m == pytest.approx(0.4 / np.sqrt(2), abs=1e-12)
    assert (result.mean_m, result.median_m, result.max_m) == pytest.approx((0.2, 0.2, 0.4), abs=1e-12)
    assert result.n == 8


def test_alignment_undoes_a_rigid_motion_and_none_does_not() -> None:
    estimate, truth = saddle()
    moved = estimate @ rotation_about_z(0.7).T + [5.0, -3.0, 2.0]
    aligned = absolute_trajectory_error(trajectory(moved), trajectory(truth), "se3")
    raw = absolute_trajectory_error(trajectory(moved), trajectory(truth), "none")
    assert not isinstance(aligned, str)
    assert not isinstance(raw, str)
    assert aligned.rmse_m == pytest.approx(0.2828427125, abs=1e-9)
    assert raw.rmse_m == pytest.approx(6.358583, abs=1e-6)
    assert np.allclose(aligned.errors_m, [0.4] * 4 + [0.0] * 4)


def test_camera_centres_are_compared_not_columns_of_the_inverse_pose() -> None:
    """A circle of twice the radius: centres are 1 m off, though the last columns of T_cam_world are all equal."""
    T = np.tile(np.eye(4), (2, 4, 1, 1))
    for k in range(4):
        T[:, k, :3, :3] = rotation_about_z(k * np.pi / 2)
        for which, radius in enumerate((1.0, 2.0)):
            T[which, k, :3, 3] = T[which, k, :3, :3] @ [radius, 0, 0]
    numbers = np.arange(4)
    truth, estimate = (Trajectory(poses, numbers, numbers.astype(float)) for poses in T)
    result = absolute_trajectory_error(estimate, truth, "se3")
    assert not isinstance(result, str)
    assert (result.rmse_m, result.mean_m) == pytest.approx((1.0, 1.0), abs=1e-12)
    scaled = absolute_trajectory_error(estimate, truth, "sim3")
    assert not isinstance(scaled, str)
    assert (scaled.rmse_m, scaled.scale) == pytest.approx((0.0, 0.5), abs=1e-12)


def test_mirrored_points_are_not_matched_by_a_reflection() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    R, _, scale = umeyama(points * [1, 1, -1], points)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert scale == 1.0


def test_sim3_finds_the_scale_worked_by_hand() -> None:
    """Of the saddle: s = 40 / 40.64, and a sum of squares of 40 - 1600 / 40.64 is left over 8 points."""
    estimate, truth = saddle()
    moved = estimate @ rotation_about_z(0.7).T + [5.0, -3.0, 2.0]
    result = absolute_trajectory_error(trajectory(moved), trajectory(truth), "sim3")
    assert not isinstance(result, str)
    assert result.scale == pytest.approx(40 / 40.64, abs=1e-12)
    assert result.rmse_m == pytest.approx(np.sqrt((40 - 1600 / 40.64) / 8), abs=1e-12)
    assert result.metrics()["scale"] == result.scale


def test_sim3_of_a_path_that_is_only_too_large_is_zero() -> None:
    along = np.random.default_rng(3).normal(size=(30, 3))
    result = absolute_trajectory_error(trajectory(2.5 * along), trajectory(along), "sim3")
    assert not isinstance(result, str)
    assert result.scale == pytest.approx(0.4)
    assert result.rmse_m == pytest.approx(0.0, abs=1e-12)
    aligned = absolute_trajectory_error(trajectory(2.5 * along), trajectory(along), "se3")
    assert not isinstance(aligned, str)
    assert aligned.scale == 1.0
    assert "scale" not in aligned.metrics()
    still = absolute_trajectory_error(trajectory(np.ones((30, 3))), trajectory(along), "sim3")
    assert still == "the estimate never moves, so that no scale can be found for it"


def test_the_aligned_poses_are_those_that_the_errors_are_of() -> None:
    """Whole poses move, not centres alone: a rigid motion leaves the motion from pose to pose as it was."""
    rng = np.random.default_rng(5)
    truth, estimate = trajectory(rng.normal(size=(9, 3))), trajectory(rng.normal(size=(9, 3)))
    estimate.T_world_cam[:, :3, :3] = rotation_about_z(0.3)
    result = absolute_trajectory_error(estimate, truth, "se3")
    assert not isinstance(result, str)
    offsets = result.aligned.T_world_cam[:, :3, 3] - truth.T_world_cam[:, :3, 3]
    assert np.allclose(np.linalg.norm(offsets, axis=1), result.errors_m)
    for poses in (estimate.T_world_cam, result.aligned.T_world_cam):
        steps = np.linalg.inv(poses[:-1]) @ poses[1:]
        assert np.allclose(steps, np.linalg.inv(estimate.T_world_cam[:-1]) @ estimate.T_world_cam[1:])


@pytest.mark.parametrize("alignment", ["se3", "sim3"])
@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_evo_on_noisy_trajectories(seed: int, alignment: str) -> None:
    evo_metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PosePath3D

    rng = np.random.default_rng(seed)
    truth = np.cumsum(rng.normal(size=(200, 3)), axis=0)
    noisy = (truth + rng.normal(scale=0.3, size=truth.shape)) @ rotation_about_z(1.1).T + [10.0, 20.0, -5.0]
    mine = absolute_trajectory_error(trajectory(noisy), trajectory(truth), alignment)
    paths = [PosePath3D(poses_se3=list(trajectory(points).T_world_cam)) for points in (truth, noisy)]
    paths[1].align(paths[0], correct_scale=alignment == "sim3")
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data(tuple(paths))
    assert not isinstance(mine, str)
    statistics = ape.get_all_statistics()
    assert mine.rmse_m == pytest.approx(statistics["rmse"], rel=1e-9)
    assert mine.median_m == pytest.approx(statistics["median"], rel=1e-9)
    assert mine.max_m == pytest.approx(statistics["max"], rel=1e-9)
    assert np.allclose(mine.errors_m, ape.error)


@pytest.mark.parametrize(("sequence", "low", "high"), [("05", 0.77, 0.84), ("06", 0.73, 0.77), ("07", 0.46, 0.54)])
def test_real_orbslam2_runs_have_their_known_errors(test_data: Path, sequence: str, low: float, high: float) -> None:
    truth = kitti_poses(test_data / "kitti_odometry" / "poses" / f"{sequence}.txt")
    files = sorted((test_data / "trajectories" / "orbslam2_stereo").glob(f"{sequence}_trial*.txt"))
    assert files
    for file in files:
        result = absolute_trajectory_error(trajectory(kitti_poses(file)[:, :3, 3]), trajectory(truth[:, :3, 3]), "se3")
        assert not isinstance(result, str)
        assert low - 0.005 <= result.rmse_m <= high + 0.005


@pytest.mark.parametrize(
    ("sequence", "expected"),
    [("03", 50.22), ("05", 52.31), ("06", 92.16), ("07", 50.82), ("09", 84.82), ("10", 69.60)],
)
def test_a_camera_that_never_moves_is_scored_too(kitti_root: Path, sequence: str, expected: float) -> None:
    truth = kitti_poses(kitti_root / "poses" / f"{sequence}.txt")[:300, :3, 3]
    result = absolute_trajectory_error(trajectory(np.zeros_like(truth)), trajectory(truth), "se3")
    assert not isinstance(result, str)
    assert result.rmse_m == pytest.approx(expected, abs=0.006)
    assert static_camera_metrics(trajectory(truth), result.numbers) == {
        "static_camera_ate_rmse_m": pytest.approx(expected, abs=0.006)
    }


def test_the_static_camera_over_lost_frames_is_stated_apart() -> None:
    """Places 0, 0, 0, 4: 3 m^2 from their mean. Over the three compared ones nothing moves."""
    truth = trajectory(np.outer([0.0, 0.0, 0.0, 4.0], [0.0, 0.6, 0.8]))
    assert static_camera_metrics(truth, np.array([0, 1, 2])) == {
        "static_camera_ate_rmse_m": pytest.approx(np.sqrt(3.0)),
        "static_camera_compared_ate_rmse_m": 0.0,
    }
    assert static_camera_metrics(truth, None) == {"static_camera_ate_rmse_m": pytest.approx(np.sqrt(3.0))}


def test_straight_lines_have_a_well_defined_error() -> None:
    """evo refuses them (rank 1): the rotation about the line is free, but it does not change the errors."""
    along = np.linspace(0, 9, 10)
    truth = np.outer(along, [0.0, 0.0, 1.0])
    estimate = np.outer(1.1 * along, [1.0, 0.0, 0.0])
    result = absolute_trajectory_error(trajectory(estimate), trajectory(truth), "se3")
    assert not isinstance(result, str)
    assert result.rmse_m == pytest.approx(0.1 * np.std(along), abs=1e-12)


def test_frames_are_matched_by_number_and_lost_ones_left_out() -> None:
    truth = np.random.default_rng(1).normal(size=(6, 3))
    kept = np.array([0, 2, 3, 5])
    wrong_if_by_position = absolute_trajectory_error(trajectory(truth[kept], kept), trajectory(truth), "none")
    assert not isinstance(wrong_if_by_position, str)
    assert wrong_if_by_position.max_m == 0.0
    assert list(wrong_if_by_position.numbers) == [0, 2, 3, 5]


def test_too_few_or_broken_poses_give_a_reason() -> None:
    truth = np.random.default_rng(1).normal(size=(6, 3))
    few = absolute_trajectory_error(trajectory(truth[:2]), trajectory(truth), "se3")
    assert few == "only 2 tracked frames have ground truth; at least 3 are needed"
    truth[4, 1] = np.nan
    broken = absolute_trajectory_error(trajectory(np.ones((6, 3))), trajectory(truth), "se3")
    assert broken == "the pose of frame 4 is not finite"
