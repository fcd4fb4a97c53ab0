"""Trajectory files against evo's readers, round trips, and one clear line for each kind of bad file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from bench.errors import BenchError
from bench.geometry import se3
from bench.io.trajectories import read_kitti_poses, read_tum, write_kitti, write_tum
from bench.types import Trajectory

IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


def poses(count: int = 20) -> np.ndarray:
    return se3.exp(np.random.default_rng(0).normal(size=(count, 6)))


def trajectory() -> Trajectory:
    return Trajectory(poses(), np.arange(20), np.arange(20) / 3.0)


def test_kitti_round_trip_and_evo_agree(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    write_kitti(path, poses())
    np.testing.assert_allclose(read_kitti_poses(path), poses(), atol=1e-14)
    np.testing.assert_array_equal(np.array(file_interface.read_kitti_poses_file(str(path)).poses_se3), poses())


def test_tum_round_trip_and_evo_agree(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.txt"
    write_tum(path, trajectory())
    path.write_text("# timestamp tx ty tz qx qy qz qw\n" + path.read_text())
    ours, theirs = read_tum(path), file_interface.read_tum_trajectory_file(str(path))
    np.testing.assert_allclose(ours.T_world_cam, poses(), atol=1e-14)
    np.testing.assert_array_equal(ours.timestamps, trajectory().timestamps)
    np.testing.assert_allclose(np.array(theirs.poses_se3), poses(), atol=1e-14)
    np.testing.assert_array_equal(theirs.timestamps, trajectory().timestamps)


def test_official_kitti_poses_read_as_evo_reads_them(kitti_root: Path) -> None:
    path = kitti_root / "poses" / "06.txt"
    ours = read_kitti_poses(path)
    assert ours.shape == (1101, 4, 4)
    np.testing.assert_allclose(ours, np.array(file_interface.read_kitti_poses_file(str(path)).poses_se3), atol=2e-6)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([IDENTITY, "1 0 0 0"], r"line 2: found 4 values, expected 12"),
        ([IDENTITY.replace("0", "inf", 1)], r"holds no pose: each of its 1 lines is NaN or zero"),
        ([IDENTITY, "", IDENTITY], r"line 2: found 0 values"),
        ([IDENTITY, IDENTITY.replace("1", "one", 1)], r"line 2: could not convert"),
        (["2 0 0 0 0 2 0 0 0 0 2 0"], r"line 1: the 3x3 part is not a rotation"),
        ([IDENTITY, "-1 0 0 0 0 1 0 0 0 0 1 0"], r"line 2: the 3x3 part is not a rotation"),
        ([""], r"holds no pose"),
    ],
)
def test_bad_kitti_lines_are_named(tmp_path: Path, lines: list[str], message: str) -> None:
    path = tmp_path / "bad.txt"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(BenchError, match=message) as error:
        read_kitti_poses(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["# a comment", "0 0 0 0 0 0 0"], r"line 2: found 7 values, expected 8"),
        (["0 0 0 0 0 0 0 1", "0.1 0 0 0 0 0 0 2"], r"line 2: the quaternion has length 2"),
        (["1 0 0 0 0 0 0 1", "0.5 0 0 0 0 0 0 1"], r"line 2: the timestamp 0.5 is not after"),
        (["1 0 0 0 0 0 0 1", "1 0 0 0 0 0 0 1"], r"line 2: the timestamp 1.0 is not after"),
        (["nan 0 0 0 0 0 0 1", "0 0 0 0 0 0 0 1"], r"line 1: the timestamp nan is not after"),
        (["0 nan 0 0 0 0 0 1"], r"holds no pose"),
    ],
)
def test_bad_tum_lines_are_named(tmp_path: Path, lines: list[str], message: str) -> None:
    path = tmp_path / "bad.txt"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(BenchError, match=message):
        read_tum(path)


def test_missing_folder_and_binary_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"does not exist"):
        read_kitti_poses(tmp_path / "none.txt")
    with pytest.raises(BenchError, match=r"Can't read"):
        read_kitti_poses(tmp_path)
    (tmp_path / "image.png").write_bytes(bytes(range(256)))
    with pytest.raises(BenchError, match=r"must be a text file"):
        read_tum(tmp_path / "image.png")
