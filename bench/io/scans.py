"""LiDAR scans: KITTI's binary files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.geometry.lidar import project_to_depth
from bench.geometry.scan_motion import compensate_motion
from bench.types import Float, Map, StereoCamera

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


class NumberedScans:
    """The scans of a folder by the number in their names; a frame may lack one, and the folder may be absent."""

    def __init__(self, folder: Path, numbers: Iterable[int]) -> None:
        """Look for the files; ``BenchError`` if that of one of the frames ``numbers`` is empty or cut."""
        self._files = {int(file.stem): file for file in folder.glob("*.bin") if file.stem.isdecimal()}
        for number in numbers:
            if number in self._files:
                check_scan_file(self._files[number])

    def __contains__(self, number: int) -> bool:
        return number in self._files

    def depth(
        self, number: int, T_left_velodyne: Float, camera: StereoCamera, T_now_before: Float | None = None
    ) -> Map | None:
        """Depth (H, W) of a frame's scan in the left image, as ``project_to_depth``; None where it has no scan.

        ``T_now_before``: as for ``compensate_motion``; None: all was measured at once, or its motion is undone already.
        """
        if number not in self._files:
            return None
        points: Float | npt.NDArray[np.float32] = read_scan(self._files[number])
        # Points behind the vehicle can't be seen; dropping them first halves the work.
        points = points[points[:, 0] > 0]
        if T_now_before is not None:
            points = compensate_motion(points, T_now_before)
        return project_to_depth(points @ T_left_velodyne[:3, :3].T + T_left_velodyne[:3, 3], camera)
