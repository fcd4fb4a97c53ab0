"""LiDAR scans: KITTI's binary files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError

POINT_BYTES = 16  # four float32 a point: x, y, z, reflectance


def check_scan_file(path: Path) -> None:
    """Raise ``BenchError`` if the size of a scan file, in bytes, can't be that of whole points."""
    size = path.stat().st_size
    if size == 0:
        raise BenchError(
            f"The velodyne file {path} is empty. Copy it again, or remove it (the frame then has no LiDAR)."
        )
    if size % POINT_BYTES:
        raise BenchError(
            f"The velodyne file {path} has {size} bytes, which is no multiple of {POINT_BYTES} (x, y, z, reflectance "
            "as float32): it is cut off. Copy it again, or remove it (the frame then has no LiDAR)."
        )


def read_scan(path: Path) -> npt.NDArray[np.float32]:
    """Points (N, 3) float32 in metres, in the sensor's frame; raises ``BenchError`` as ``check_scan_file``."""
    check_scan_file(path)
    return np.fromfile(path, dtype=np.float32).reshape(-1, 4)[:, :3]
