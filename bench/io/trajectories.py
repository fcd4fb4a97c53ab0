"""Read and write trajectories in KITTI's and TUM's text formats.

KITTI: one pose per line, the twelve numbers of the upper 3x4 of T_world_cam, row by row. TUM: one pose per line,
``timestamp tx ty tz qx qy qz qw``; empty lines and lines that start with ``#`` are skipped. A line with NaN or
infinity, or with nothing but zeros for the rotation, says that the pose of that frame is unknown.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError, first_line
from bench.geometry import se3
from bench.io.text_files import read_text
from bench.types import Float, Trajectory

_ROTATION_TOLERANCE = 1e-2
"""How far R R^T may be from the identity: above the rounding of files with four digits, below any wrong matrix."""
FARTHEST_M = 1e9
"""No camera gets so far, in any frame of the Earth's; the squares of such numbers fill a float."""


def read_kitti_poses(path: Path | str, matrix_rows: int = 3) -> Float:
    """T_world_cam (N, 4, 4) of a KITTI pose file, one per line; NaN where a line says that the pose is unknown.

    With ``matrix_rows`` 4 each line has the whole matrix, as Replica's files do. Rotations are made orthonormal (files
    carry 7 digits). Raises ``BenchError`` with the line for anything but twelve (sixteen) numbers whose 3x3 block is a
    rotation, and for an empty line between others, as lines count frames.
    """
    path = Path(path)
    numbers = 4 * matrix_rows
    table, lines = _read_table(
        path, numbers, f"{numbers} numbers (the {matrix_rows}x4 pose, row by row)", lines_count=True
    )
    table = table[:, :12]
    known = _known(table, table.reshape(-1, 3, 4)[:, :, :3].reshape(-1, 9), path)
    _require_near(table[:, 3::4], lines, path)
    T = np.tile(np.eye(4), (int(known.sum()), 1, 1))
    T[:, :3] = table[known].reshape(-1, 3, 4)
    R = T[:, :3, :3]
    with np.errstate(all="ignore"):  # of numbers without measure
        wrong = ~(np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2)) <= _ROTATION_TOLERANCE)
        wrong |= ~(np.linalg.det(R) > 0)
    if wrong.any():
        line = lines[int(np.flatnonzero(known)[np.argmax(wrong)])]
        raise BenchError(
            f"{path}, line {line}: the 3x3 part is not a rotation. Expected T_world_cam, row by row: r11 r12 r13 tx ..."
        )
    poses = np.full((len(table), 4, 4), np.nan)
    poses[known] = se3.orthonormalise(T)
    return poses


def _require_near(positions: Float, lines: list[int], path: Path) -> None:
    """Raise ``BenchError`` for the first line whose position (N, 3) is farther off than any."""
    far = (np.isfinite(positions) & (np.abs(positions) > FARTHEST_M)).any(axis=1)
    if far.any():
        raise BenchError(
            f"{path}, line {lines[int(np.argmax(far))]}: the position is farther than {FARTHEST_M:g} m. Is the file "
            "damaged, or in another unit?"
        )


def known_poses(T: Float) -> npt.NDArray[np.bool_]:
    """Which of the poses (N, 4, 4) of a file's lines are known, (N,)."""
    return np.asarray(np.isfinite(T).all(axis=(1, 2)))


def read_tum(path: Path | str) -> Trajectory:
    """Trajectory of the known poses of a TUM file; ``numbers`` count its poses from 0, the unknown ones too.

    Raises ``BenchError`` as ``read_tum_lines``.
    """
    times, T = read_tum_lines(path)
    known = known_poses(T)
    return Trajectory(T[known], np.flatnonzero(known), times[known])


def read_tum_lines(path: Path | str) -> tuple[Float, Float]:
    """Times (N,) and poses (N, 4, 4) of a TUM file, one per line; NaN where a line says that the pose is unknown.

    Raises ``BenchError`` with the line for anything but eight numbers, a quaternion (x, y, z, w) that is not of unit
    length, or a time that is not after the one before.
    """
    path = Path(path)
    table, lines = _read_table(path, 8, "8 numbers: timestamp tx ty tz qx qy qz qw", lines_count=False)
    T = _of_quaternions(table[:, 1:], lines, path)
    late = np.flatnonzero(~(np.diff(table[:, 0], prepend=-np.inf) > 0))
    if len(late):
        at = int(late[0])
        raise BenchError(
            f"{path}, line {lines[at]}: the timestamp {table[at, 0]} is not after the one before. Sort it by time."
        )
    return table[:, 0], T


def read_poses_without_times(path: Path | str) -> Float:
    """Poses (N, 4, 4) of a file of lines ``tx ty tz qx qy qz qw``, one per frame; otherwise as ``read_tum_lines``."""
    path = Path(path)
    table, lines = _read_table(path, 7, "7 numbers: tx ty tz qx qy qz qw", lines_count=True)
    return _of_quaternions(table, lines, path)


def _of_quaternions(table: Float, lines: list[int], path: Path) -> Float:
    """Poses (N, 4, 4) of rows tx ty tz qx qy qz qw, (N, 7); NaN where a row says that the pose is unknown."""
    known = _known(table, table[:, 3:], path)
    _require_near(table[:, :3], lines, path)
    with np.errstate(all="ignore"):  # of numbers without measure
        length = np.linalg.norm(table[:, 3:], axis=1)
    wrong = known & (np.abs(length - 1.0) > _ROTATION_TOLERANCE)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise BenchError(
            f"{path}, line {lines[at]}: the quaternion has length {length[at]:.4g}, not 1. Expected qx qy qz qw in the "
            "last four columns."
        )
    T = np.full((len(table), 4, 4), np.nan)
    T[known] = se3.compose(se3.quaternion_to_rotation(table[known, 3:]), table[known, :3])
    return T


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


def _known(table: Float, rotations: Float, path: Path) -> npt.NDArray[np.bool_]:
    """Which lines hold a pose; ``BenchError`` where none does."""
    known = np.isfinite(table).all(axis=1) & rotations.any(axis=1)
    if not known.any():
        raise BenchError(f"{path} holds no pose: each of its {len(table)} lines is NaN or zero. Check the file.")
    return np.asarray(known)


def _read_table(path: Path, columns: int, expected: str, lines_count: bool) -> tuple[Float, list[int]]:
    """Numbers (N, columns) and the 1-based line of each row; raises ``BenchError`` at the first line that is wrong.

    Where lines count frames there are no comments, and an empty line between others is wrong.
    """
    rows: list[list[float]] = []
    lines: list[int] = []
    text = read_text(path, "trajectory file")
    for line, content in enumerate((text.rstrip() if lines_count else text).splitlines(), start=1):
        words = content.split()
        if not lines_count and (not words or words[0].startswith("#")):
            continue
        if len(words) != columns:
            raise BenchError(f"{path}, line {line}: found {len(words)} values, expected {expected}.")
        try:
            rows.append([float(word) for word in words])
        except ValueError as error:
            raise BenchError(f"{path}, line {line}: {first_line(error)}; expected {expected}.") from None
        lines.append(line)
    if not rows:
        raise BenchError(f"{path} holds no pose. Expected one per line: {expected}.")
    return np.array(rows), lines


def values_per_line(path: Path, what: str = "trajectory file") -> int:
    """How many values the first line has that is neither empty nor a comment: 12 in KITTI's format, 8 in TUM's."""
    lines = (line.split() for line in read_text(path, what).splitlines())
    return next((len(words) for words in lines if words and not words[0].startswith("#")), 0)
