"""Text files of KITTI raw: the calibration of a day, and the GPS/IMU's packets (``oxts``).

Layout and formulas: Geiger, Lenz, Stiller and Urtasun, "Vision meets robotics: the KITTI dataset", IJRR 2013. Frames:
"rect0" is the left grey camera after rectification, "velodyne" the LiDAR, "imu" the GPS/IMU (x ahead, y left, z up).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bench.errors import BenchError
from bench.geometry import se3
from bench.io.kitti360_files import NumberedPoses
from bench.io.kitti_files import KittiCalibration, parse_numbers, read_lines
from bench.io.named_matrices import named_numbers, named_rotation, rigid
from bench.types import Float, StereoCamera

_EARTH_RADIUS_M = 6378137.0
_PACKET = 30
"""Numbers of a packet; latitude, longitude (degrees), altitude (m), roll, pitch, yaw (radians) are the first."""


class RawCalibration:
    """``calib_cam_to_cam.txt``, ``calib_velo_to_cam.txt`` and ``calib_imu_to_velo.txt`` of a day.

    Each method raises ``BenchError`` with file and line for what is absent or wrong.
    """

    def __init__(self, day: Path) -> None:
        """Read the cameras; ``BenchError`` if the folder of the ``day`` lacks their file."""
        self._day, self._cameras = day, day / "calib_cam_to_cam.txt"
        if not self._cameras.is_file():
            raise BenchError(f"{self._cameras} is missing. Unpack KITTI raw's {day.name}_calib.zip beside {day.name}.")
        self._projections = KittiCalibration(self._cameras)

    def stereo_camera(self, left: int, right: int, size: tuple[int, int]) -> StereoCamera:
        """The rectified pair of these two cameras, whose images must have this (width, height) in pixels."""
        for camera in (left, right):
            written, line = named_numbers(self._cameras, f"S_rect_0{camera}", 2)
            if tuple(written.astype(int)) != size:
                raise BenchError(
                    f"The images are {size[0]}x{size[1]} pixels, but {self._cameras}, line {line}, is for "
                    f"{written[0]:.0f}x{written[1]:.0f}. Use the images of drives whose names end in _sync."
                )
        return self._projections.stereo_camera(left, right, size)

    def T_left_velodyne(self, left: int) -> Float:
        """4x4, metres: from the LiDAR to the rectified camera ``left``, [I | t_left] R_rect_00 (calib_velo_to_cam)."""
        T_left_rect0 = np.eye(4)
        T_left_rect0[:3, 3] = self._projections.projection(left)[1]
        return T_left_rect0 @ named_rotation(self._cameras, "R_rect_00") @ self._motion("calib_velo_to_cam.txt")

    def T_velodyne_imu(self) -> Float:
        """4x4, metres: from the GPS/IMU to the LiDAR."""
        return self._motion("calib_imu_to_velo.txt")

    def _motion(self, name: str) -> Float:
        """Lines ``R: 9 numbers`` and ``T: 3 numbers`` of a file."""
        path = self._day / name
        R, line = named_numbers(path, "R", 9)
        t, _ = named_numbers(path, "T", 3)
        return rigid(np.column_stack([R.reshape(3, 3), t]), path, line)


def read_oxts(folder: Path, numbers: Iterable[int]) -> NumberedPoses | None:
    """T_world_imu of those frames that have a packet; None where none has. ``BenchError`` for a malformed packet.

    The world is a Mercator plane of the first one's latitude, with x to the east, y to the north and z up, in metres.
    """
    files = {number: folder / f"{number:010d}.txt" for number in sorted(set(numbers))}
    packets = {number: _packet(file) for number, file in files.items() if file.is_file()}
    if not packets:
        return None
    return NumberedPoses(np.array(list(packets)), poses_of_packets(np.stack(list(packets.values()))), folder)


def _packet(path: Path) -> Float:
    lines = read_lines(path)
    if len(lines) != 1:
        raise BenchError(f"{path} has {len(lines)} lines, expected one of {_PACKET} numbers. Unpack the drive again.")
    values = parse_numbers(lines[0], _PACKET, path, 1)[:6]
    if not (abs(values[0]) < 89 and abs(values[1]) <= 360 and (np.abs(values[3:]) < 7).all()):
        raise BenchError(
            f"{path}: {values[0]:g}, {values[1]:g} is no latitude and longitude in degrees, or the three angles behind "
            "are not in radians. Unpack the drive again."
        )
    return values


def poses_of_packets(packets: Float) -> Float:
    """T_world_imu (N, 4, 4) of packets (N, 6): latitude, longitude in degrees, altitude in m, roll, pitch, yaw."""
    latitude, longitude = np.radians(packets[:, 0]), np.radians(packets[:, 1])
    scale = np.cos(latitude[0]) * _EARTH_RADIUS_M
    north = np.log(np.tan(np.pi / 4 + latitude / 2))
    positions = np.column_stack([scale * longitude, scale * north, packets[:, 2]])
    roll, pitch, yaw = (se3.so3_exp(packets[:, 3 + i, None] * np.eye(3)[i]) for i in range(3))
    return se3.compose(yaw @ pitch @ roll, positions)
