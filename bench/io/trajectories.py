"""Read and write trajectories in KITTI's and TUM's text formats.

KITTI: one pose per line, the twelve numbers of the upper 3x4 of T_world_cam, row by row. TUM: one pose per line,
``timestamp tx ty tz qx qy qz qw``; empty lines and lines that start with ``#`` are skipped.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.errors import BenchError
from bench.geometry import se3
from bench.types import Float, Trajectory

_ROTATION_TOLERANCE = 1e-2
"""How far R R^T may be from the identity: above the rounding of files with four digits, below any wrong matrix."""


def read_kitti_poses(path: Path | str) -> Float:
    """T_world_cam (N, 4, 4) of a KITTI pose file, rotations made orthonormal (files carry 7 digits).

    Raises ``BenchError`` with the line for anything but twelve finite numbers whose 3x3 block is a rotation.
    """
    path = Path(path)
    table, lines = _read_table(path, 12, "12 numbers (the 3x4 pose, row by row)", skip_comments=False)
    T = np.tile(np.eye(4), (len(table), 1, 1))
    T[:, :3] = table.reshape(-1, 3, 4)
    R = T[:, :3, :3]
    wrong = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2)) > _ROTATION_TOLERANCE
    wrong |= np.linalg.det(R) < 0
    if wrong.any():
        line = lines[int(np.argmax(wrong))]
        raise BenchError(
            f"{path}, line {line}: the 3x3 part is not a rotation. Expected T_world_cam, row by row: r11 r12 r13 tx ..."
        )
    return se3.orthonormalise(T)


def read_tum(path: Path | str) -> Trajectory:
    """Trajectory of a TUM file; ``numbers`` are 0, 1, 2 ... in the order of the lines.

    Raises ``BenchError`` with the line for anything but eight finite numbers, a quaternion (x, y, z, w) that is not of
    unit length, or a time that is not after the one before.
    """
    path = Path(path)
    table, lines = _read_table(path, 8, "8 numbers: timestamp tx ty tz qx qy qz qw", skip_comments=True)
    length = np.linalg.norm(table[:, 4:], axis=1)
    wrong = np.abs(length - 1.0) > _ROTATION_TOLERANCE
    if wrong.any():
        at = int(np.argmax(wrong))
        raise BenchError(
            f"{path}, line {lines[at]}: the quaternion has length {length[at]:.4g}, not 1. Expected qx qy qz qw in the "
            "last four columns."
        )
    late = np.flatnonzero(np.diff(table[:, 0]) <= 0)
    if len(late):
        at = int(late[0]) + 1
        raise BenchError(
            f"{path}, line {lines[at]}: the timestamp {table[at, 0]} is not after the one before. Sort it by time."
        )
    T = se3.compose(se3.quaternion_to_rotation(table[:, 4:]), table[:, 1:4])
    return Trajectory(T, np.arange(len(table)), table[:, 0])


def write_kitti(path: Path | str, poses: Float) -> None:
    """Write T_world_cam (N, 4, 4) as a KITTI pose file; reading it back gives the same float64."""
    _write(path, np.asarray(poses, dtype=np.float64)[:, :3].reshape(-1, 12))


def write_tum(path: Path | str, trajectory: Trajectory) -> None:
    """Write timestamps and poses as a TUM file, quaternions ordered (x, y, z, w)."""
    T = trajectory.T_world_cam
    quaternions = se3.rotation_to_quaternion(T[:, :3, :3])
    _write(path, np.column_stack([trajectory.timestamps, T[:, :3, 3], quaternions]))


def _write(path: Path | str, table: Float) -> None:
    # repr of a float is the shortest text that reads back as the same float.
    text = "".join(" ".join(map(repr, row)) + "\n" for row in table.tolist())
    Path(path).write_text(text, encoding="ascii")


def _read_table(path: Path, columns: int, expected: str, skip_comments: bool) -> tuple[Float, list[int]]:
    """Numbers (N, columns) and the 1-based line of each row; raises ``BenchError`` at the first line that is wrong."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BenchError(f"The trajectory file {path} does not exist. Check the path.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"Can't read the trajectory file {path}: {error}. It must be a text file.") from None
    rows: list[list[float]] = []
    lines: list[int] = []
    for line, content in enumerate(text.splitlines(), start=1):
        words = content.split()
        if not words or (skip_comments and words[0].startswith("#")):
            continue
        if len(words) != columns:
            raise BenchError(f"{path}, line {line}: found {len(words)} values, expected {expected}.")
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise BenchError(f"{path}, line {line}: {error}; expected {expected}.") from None
        if not np.isfinite(row).all():
            raise BenchError(f"{path}, line {line}: NaN or infinity in the pose. Remove the line, or repair the file.")
        rows.append(row)
        lines.append(line)
    if not rows:
        raise BenchError(f"{path} holds no pose. Expected one per line: {expected}.")
    return np.array(rows), lines
