"""Relative pose error: cases worked by hand, and evo as an independent oracle."""

from __future__ import annotations

import numpy as np
import pytest

from bench.evaluation.rpe import RpeResult, relative_pose_error
from bench.types import Trajectory


def rotation_about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def trajectory(T: np.ndarray, numbers: np.ndarray | None = None) -> Trajectory:
    numbers = np.arange(len(T)) if numbers is None else numbers
    return Trajectory(T, numbers, 0.1 * numbers)


def straight(step_m: float, n: int, yaw_per_frame: float = 0.0) -> np.ndarray:
    T = np.tile(np.eye(4), (n, 1, 1))
    for i in range(n):
        T[i, 2, 3] = step_m * i
        T[i, :3, :3] = rotation_about_y(yaw_per_frame * i)
    return T


def random_walk(seed: int, n: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (n, 1, 1))
    for i in range(1, n):
        step = np.eye(4)
        step[:3, :3] = rotation_about_y(rng.normal(0, 0.1))
        step[:3, 3] = rng.normal([0, 0, 1], 0.2)
        T[i] = T[i - 1] @ step
    return T


def scored(estimate: Trajectory, truth: Trajectory, frame_distance: int = 1) -> RpeResult:
    result = relative_pose_error(estimate, truth, frame_distance)
    assert isinstance(result, RpeResult)
    return result


def test_one_percent_too_fast_and_slowly_turning() -> None:
    """Steps of 1.01 m for 1 m are wrong by 0.01 m; 0.01 rad too many a frame are 0.03 rad over three frames."""
    result = scored(trajectory(straight(1.01, 11)), trajectory(straight(1.0, 11)))
    assert np.allclose(result.translation_m, 0.01)
    assert np.allclose(result.rotation_deg, 0.0)
    turning = scored(trajectory(straight(1.0, 11, yaw_per_frame=0.01)), trajectory(straight(1.0, 11)), 3)
    assert np.allclose(turning.rotation_deg, np.rad2deg(0.03))
    assert turning.metrics()["rpe_pairs"] == 8
    assert turning.metrics()["rpe_rot_mean_deg"] == pytest.approx(np.rad2deg(0.03))


def test_mean_and_rmse_of_unequal_errors() -> None:
    """Steps of 1, 1 and 4 m where the truth has 1: errors 0, 0, 3, so mean 1 and RMSE sqrt(3)."""
    estimate = straight(1.0, 4)
    estimate[3, 2, 3] += 3.0
    metrics = scored(trajectory(estimate), trajectory(straight(1.0, 4))).metrics()
    assert metrics["rpe_trans_mean_m"] == pytest.approx(1.0)
    assert metrics["rpe_trans_rmse_m"] == pytest.approx(np.sqrt(3.0))


@pytest.mark.parametrize("frame_distance", [1, 7])
def test_agrees_with_evo(frame_distance: int) -> None:
    evo_metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PosePath3D

    truth, estimate = random_walk(1, 120), random_walk(2, 120)
    result = scored(trajectory(estimate), trajectory(truth), frame_distance)
    paths = (PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate)))
    for relation, mine in (
        (evo_metrics.PoseRelation.translation_part, result.translation_m),
        (evo_metrics.PoseRelation.rotation_angle_deg, result.rotation_deg),
    ):
        rpe = evo_metrics.RPE(relation, delta=frame_distance, delta_unit=evo_metrics.Unit.frames, all_pairs=True)
        rpe.process_data(paths)
        assert np.allclose(rpe.error, mine, atol=1e-7)


def test_moving_the_whole_estimate_changes_nothing() -> None:
    truth, estimate = random_walk(1, 50), random_walk(2, 50)
    O = random_walk(3, 9)[8]  # noqa: E741 - the offset
    one, two = scored(trajectory(estimate), trajectory(truth)), scored(trajectory(O @ estimate), trajectory(truth))
    assert np.allclose(one.translation_m, two.translation_m)
    in_another_camera = scored(trajectory(truth @ O), trajectory(truth))
    assert in_another_camera.translation_m.max() > 0.1


def test_lost_frames_break_pairs_and_are_counted() -> None:
    """Ten frames, 3 and 7 lost; what happens across them must not enter."""
    kept = np.array([0, 1, 2, 4, 5, 6, 8, 9])
    estimate = straight(1.0, 10)
    estimate[4:, 0, 3] += 100.0
    estimate[8:, 0, 3] += 100.0
    result = scored(trajectory(estimate[kept], kept), trajectory(straight(1.0, 10)))
    assert list(zip(result.first, result.last, strict=True)) == [(0, 1), (1, 2), (4, 5), (5, 6), (8, 9)]
    assert result.translation_m.max() == pytest.approx(0.0)
    assert result.metrics()["rpe_pairs_lost"] == 4


def test_pairs_are_of_frames_of_the_run_whatever_their_numbers() -> None:
    """Every third frame of a data set, of which the ground truth lacks number 9: 6 to 12 is no pair."""
    numbers = np.array([0, 3, 6, 12, 15])
    poses = straight(1.0, 16)[numbers]
    result = scored(trajectory(poses, numbers), trajectory(poses, numbers))
    assert list(result.last) == [3, 6, 15]
    assert result.pairs_lost == 0


def test_nothing_to_compare_gives_the_reason() -> None:
    truth = trajectory(straight(1.0, 6))
    even = np.array([0, 2, 4])
    assert relative_pose_error(trajectory(truth.T_world_cam[even], even), truth) == (
        "no two tracked frames are 1 apart (5 pairs are lost)"
    )
    assert "too few for a pair 6 apart" in str(relative_pose_error(truth, truth, 6))
    broken = straight(1.0, 6)
    broken[4, 1, 3] = np.nan
    assert relative_pose_error(trajectory(broken), truth) == "the pose of frame 3 or 4 is not finite"
