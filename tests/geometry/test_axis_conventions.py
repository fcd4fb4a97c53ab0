"""Conventions are told apart on drives made by hand, and on all real trajectories of KITTI odometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.geometry import se3
from bench.geometry.axis_conventions import suspected_convention

# Body axes (x forward, y left, z up) in camera axes (x right, y down, z forward).
T_CAM_BODY = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64)


def loop(count: int = 80, turn: float = 2 * np.pi) -> np.ndarray:
    """A car that turns by ``turn`` in all, 1 m per frame, written down without se3: x = right, z = forward."""
    T = np.tile(np.eye(4), (count, 1, 1))
    heading = np.linspace(0, turn, count)
    T[:, 0, 0] = T[:, 2, 2] = np.cos(heading)
    T[:, 0, 2], T[:, 2, 0] = np.sin(heading), -np.sin(heading)
    T[1:, 0, 3], T[1:, 2, 3] = np.cumsum(np.sin(heading[:-1])), np.cumsum(np.cos(heading[:-1]))
    return T


def misread(T: np.ndarray) -> np.ndarray:
    """The poses as they are read when w, x, y, z are taken for x, y, z, w."""
    quaternions = se3.rotation_to_quaternion(T[:, :3, :3])
    return se3.compose(se3.quaternion_to_rotation(np.roll(quaternions, 1, axis=1)), T[:, :3, 3])


@pytest.mark.parametrize("turn", [0.0, 0.3, 2 * np.pi])
def test_drives_by_hand(turn: float) -> None:
    T = loop(turn=turn)
    assert suspected_convention(T) is None
    assert suspected_convention(np.linalg.inv(T)) == (
        "the poses look like world to camera, or the camera drives backwards; ours are camera to world"
    )
    body = "the poses look like those of a body frame (x forward, z up); ours have x right, y down, z forward"
    assert suspected_convention(T @ T_CAM_BODY) == body
    assert suspected_convention(np.linalg.inv(T_CAM_BODY) @ T @ T_CAM_BODY) == body
    assert suspected_convention(misread(T)) == "the quaternions look like qw qx qy qz; TUM's order is qx qy qz qw"


def test_where_the_world_is_and_how_it_is_turned_does_not_matter() -> None:
    elsewhere = se3.exp(np.array([500.0, -20.0, 3.0, 0.4, -1.0, 2.0]))
    assert suspected_convention(elsewhere @ loop()) is None
    assert suspected_convention(elsewhere @ loop() @ T_CAM_BODY) is not None


def test_what_can_not_be_judged_is_left_alone() -> None:
    assert suspected_convention(np.tile(np.eye(4), (50, 1, 1))) is None
    assert suspected_convention(loop()[:1]) is None
    assert suspected_convention(se3.exp(np.random.default_rng(0).normal(size=(50, 6)))) is None
    sideways = loop(turn=0.0)
    sideways[:, :3, 3] = sideways[:, [1, 2, 0], 3]  # straight up
    assert suspected_convention(sideways) is None


def test_all_real_trajectories(kitti_root: Path) -> None:
    for file in sorted((kitti_root / "poses").glob("*.txt")):
        table = np.loadtxt(file).reshape(-1, 3, 4)
        T = np.tile(np.eye(4), (len(table), 1, 1))
        T[:, :3] = table
        assert suspected_convention(T) is None, file
        assert "world to camera" in str(suspected_convention(np.linalg.inv(T))), file
        assert "body frame" in str(suspected_convention(T @ T_CAM_BODY)), file
        assert "qw qx qy qz" in str(suspected_convention(misread(T))), file
