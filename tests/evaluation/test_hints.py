"""Conventions and units that two trajectories differ in are told, on drives made by hand; differences of trackers are
not, on real ones."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bench.evaluation.hints import hints
from bench.evaluation.score import score_pair
from bench.evaluation.trajectory_pair import TrajectoryPair, read_pair
from bench.geometry import se3
from bench.io.trajectories import write_kitti, write_tum
from bench.types import Trajectory

FLU = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Columns: where a robot's x (forward), y (left) and z (up) lie in the camera's right, down, forward."""
FRD = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
OPENGL = np.diag([1.0, -1.0, -1.0])
ELSEWHERE = se3.exp(np.array([5.0, -20.0, 3.0, 0.4, -1.0, 2.0]))


def drive(count: int = 120) -> np.ndarray:
    """A car on a winding and hilly road, a metre a frame, its pitch and roll as roads have them."""
    at = np.arange(count)
    turn = np.column_stack([0.02 * np.sin(at / 7), 0.03 * np.cos(at / 20) + 0.01, 0.01 * np.sin(at / 5)])
    steps = se3.compose(se3.so3_exp(turn), np.tile([0.0, 0.0, 1.0], (count, 1)))
    T = [np.eye(4)]
    for step in steps[1:]:
        T.append(T[-1] @ step)
    return np.array(T)


def tracked(count: int = 120) -> np.ndarray:
    """The drive as a tracker gives it: a percent of drift, in a world of its own."""
    rng = np.random.default_rng(0)
    noise = se3.exp(rng.normal(0, [0.01, 0.01, 0.01, 1e-3, 1e-3, 1e-3], (count, 6)))
    steps = (se3.inverse(drive(count)[:-1]) @ drive(count)[1:]) @ noise[1:]
    T = [ELSEWHERE]
    for step in steps:
        T.append(T[-1] @ step)
    return np.array(T)


def turned(T: np.ndarray, axes: np.ndarray) -> np.ndarray:
    return T @ se3.compose(axes, np.zeros(3))


def rolled(T: np.ndarray, shift: int = 1) -> np.ndarray:
    """As poses are read whose quaternions were written w, x, y, z."""
    quaternions = np.roll(se3.rotation_to_quaternion(T[:, :3, :3]), shift, axis=1)
    return se3.compose(se3.quaternion_to_rotation(quaternions), T[:, :3, 3])


def scaled(T: np.ndarray, factor: float) -> np.ndarray:
    return se3.compose(T[:, :3, :3], factor * T[:, :3, 3])


def trajectory(T: np.ndarray) -> Trajectory:
    numbers = np.arange(len(T))
    return Trajectory(T, numbers, 0.1 * numbers)


def hinted(T: np.ndarray, truth: np.ndarray) -> dict[str, str]:
    return hints(trajectory(T), trajectory(truth))


READINGS = [
    ("as world to camera", se3.inverse),
    ("with quaternions in the order w x y z", rolled),
    ("with rotations from world to camera", lambda T: se3.compose(np.swapaxes(T[:, :3, :3], 1, 2), T[:, :3, 3])),
    ("in axes x forward, y left, z up", lambda T: turned(T, FLU)),
    ("in axes x forward, y right, z down", lambda T: turned(T, FRD)),
    ("in axes x right, y up, z back", lambda T: turned(T, OPENGL)),
    ("as world to camera, in axes x right, y up, z back", lambda T: se3.inverse(turned(T, OPENGL))),
    ("with quaternions in the order w x y z, in axes x forward, y left, z up", lambda T: rolled(turned(T, FLU))),
]


@pytest.mark.parametrize(("words", "write"), READINGS)
@pytest.mark.parametrize("count", [12, 120])
def test_another_convention_of_the_estimate_or_the_truth(words: str, write: object, count: int) -> None:
    assert callable(write)
    said = hinted(write(tracked(count)), drive(count))
    assert set(said) == {"convention"}
    assert f"the estimate read {words}" in said["convention"]
    said = hinted(tracked(count), write(drive(count)))
    assert set(said) == {"convention"}
    assert f"the ground truth read {words}" in said["convention"]


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (
            1000.0,
            "the estimate has the shape of the other trajectory and is [0-9.]+ times as large. .* in millimetres",
        ),
        (100.0, "the estimate .* times as large. Is it, or the baseline that it was made with, in centimetres"),
        (1e-3, "the ground truth .* times as large. Is it in millimetres"),
        (2.2, "the estimate .* is 2.[0-9]+ times as large. Check the unit of both, and the calibration's focal length"),
    ],
)
def test_another_unit(factor: float, words: str) -> None:
    said = hinted(scaled(tracked(), factor), drive())
    assert set(said) == {"scale"}
    assert re.search(words, said["scale"])


@pytest.mark.parametrize("sigma_m", [0.0, 0.1, 1.0])
def test_good_and_bad_trackers_get_no_hint(sigma_m: float) -> None:
    rng = np.random.default_rng(1)
    T = tracked()
    T[:, :3, 3] += rng.normal(0, sigma_m, (len(T), 3))
    assert hinted(T, drive()) == {}
    assert hinted(np.tile(np.eye(4), (120, 1, 1)), drive()) == {}
    assert hinted(drive(), np.tile(np.eye(4), (120, 1, 1))) == {}
    assert hinted(drive(4), drive(4)) == {}
    standing = 1e-3 * rng.normal(size=(2, 12, 3))
    assert hinted(*(se3.compose(np.tile(np.eye(3), (12, 1, 1)), each) for each in standing)) == {}


def test_no_real_trajectory_gets_a_hint(test_data: Path) -> None:
    for file in sorted((test_data / "trajectories/orbslam2_stereo").glob("*_trial0.txt")):
        pair = read_pair(file, test_data / f"kitti_odometry/poses/{file.name[:2]}.txt")
        for part in (slice(0, 12), slice(200, 260), slice(None)):
            estimate, truth = (
                Trajectory(T.T_world_cam[part], T.numbers[part], T.timestamps[part])
                for T in (pair.estimate, pair.ground_truth)
            )
            assert hints(estimate, truth) == {}


def test_score_tells_and_leaves_the_numbers(tmp_path: Path) -> None:
    write_kitti(tmp_path / "gt.txt", drive())
    write_kitti(tmp_path / "w2c.txt", np.linalg.inv(drive()))
    metrics = score_pair(read_pair(tmp_path / "w2c.txt", tmp_path / "gt.txt"), "se3").metrics
    assert "read as world to camera" in metrics["notes"]["convention"]
    assert metrics["trajectory"]["rpe_trans_rmse_m"] > 1.0
    write_tum(tmp_path / "gt.tum", trajectory(drive()))
    write_tum(tmp_path / "wxyz.tum", trajectory(rolled(drive(), 1)))
    metrics = score_pair(read_pair(tmp_path / "wxyz.tum", tmp_path / "gt.tum"), "se3").metrics
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-4)
    assert "quaternions in the order w x y z" in metrics["notes"]["convention"]


def test_a_scale_that_is_asked_for_is_no_news() -> None:
    pair = TrajectoryPair(trajectory(scaled(tracked(), 0.01)), trajectory(drive()), 0, 0, "line")
    assert "scale" in score_pair(pair, "se3").metrics["notes"]
    assert "scale" not in score_pair(pair, "sim3").metrics["notes"]
