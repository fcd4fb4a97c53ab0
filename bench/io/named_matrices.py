"""Matrices in the text files of calibrations: lines ``NAME: numbers``, and 3x4 blocks that must be rigid motions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.geometry import se3
from bench.io.kitti_files import parse_numbers, read_lines
from bench.types import Float

_ROTATION_TOLERANCE = 1e-2


def named_numbers(path: Path, name: str, count: int) -> tuple[Float, int]:
    """The ``count`` numbers of the line ``NAME: ...`` and that line's number; other lines may hold anything.

    Raises ``BenchError`` where there is no such line, or another count of numbers in it.
    """
    names = []
    for line, text in enumerate(read_lines(path), start=1):
        key, _, rest = text.partition(":")
        if key.strip() == name:
            return parse_numbers(rest, count, path, line), line
        names.append(key.strip())
    have = ", ".join(names[:8]) or "nothing"
    raise BenchError(f"{path} has no line '{name}:' (it has {have}). Restore it from the data set's calibration files.")


def is_rotation(R: Float) -> npt.NDArray[np.bool_]:
    """Of matrices (..., 3, 3): which are rotations up to the rounding of the files."""
    with np.errstate(over="ignore", invalid="ignore"):  # damaged numbers are no rotation either
        off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-1, -2))
        return np.asarray((off < _ROTATION_TOLERANCE) & (np.linalg.det(R) > 0))


def rigid(matrix: Float, path: Path, line: int) -> Float:
    """The motion (4, 4) of a 3x4 block, its rotation made exact; ``BenchError`` with the line if it is none."""
    T = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if not is_rotation(T[:3, :3]):
        raise BenchError(f"{path}, line {line}: the 3x3 part is not a rotation. Restore the file.")
    return se3.orthonormalise(T)


def named_rotation(path: Path, name: str) -> Float:
    """The motion (4, 4) without translation of the line ``NAME: 9 numbers``; ``BenchError`` if it is none."""
    values, line = named_numbers(path, name, 9)
    return rigid(np.column_stack([values.reshape(3, 3), np.zeros(3)]), path, line)
