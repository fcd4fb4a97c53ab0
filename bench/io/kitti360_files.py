"""Text files of KITTI-360: calibration, numbered poses, image times.

Layout: Liao, Xie and Geiger, "KITTI-360", PAMI 2022, and the data set's documentation. Frames: "rect0" is the rectified
left camera image_00, "cam0" the same one before rectification, "pose" the vehicle's GPS/IMU, "velodyne" the LiDAR.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.geometry import se3
from bench.io.kitti_files import parse_numbers, read_lines
from bench.io.named_matrices import is_rotation, named_numbers, named_rotation, rigid
from bench.types import Float, StereoCamera

# The two pose files say the same up to the digits that they are written with.
_AGREEMENT = 1e-3
_SAMPLE = 50


class Kitti360Calibration:
    """The folder ``calibration/``. Each method raises ``BenchError`` with file and line for what is absent or wrong."""

    def __init__(self, folder: Path) -> None:
        """Remember the folder; files are read when they are asked for. ``BenchError`` if it does not exist."""
        if not folder.is_dir():
            raise BenchError(f"The folder {folder} does not exist. Unpack KITTI-360's calibration.zip there.")
        self._folder = folder
        self.perspective = folder / "perspective.txt"

    def stereo_camera(self, size: tuple[int, int]) -> StereoCamera:
        """The rectified pair image_00, image_01, whose images have this (width, height) in pixels."""
        P = [named_numbers(self.perspective, f"P_rect_0{i}", 12)[0].reshape(3, 4) for i in range(2)]
        for i, each in enumerate(P):
            K = each[:, :3]
            if not (K[0, 0] > 0 and K[1, 1] > 0 and np.allclose(K[2], [0, 0, 1]) and abs(K[0, 1]) < 1e-9):
                raise BenchError(
                    f"{self.perspective}: P_rect_0{i} is not the projection of a rectified camera. Restore the file."
                )
        K = P[0][:, :3]
        if not np.allclose(K, P[1][:, :3], atol=1e-6):
            raise BenchError(
                f"{self.perspective}: P_rect_00 and P_rect_01 differ in K, which a rectified pair shares. Restore it."
            )
        t_left, t_right = (np.linalg.solve(K, each[:, 3]) for each in P)
        if np.abs(t_left).max() > 1e-6:
            raise BenchError(
                f"{self.perspective}: the last column of P_rect_00 must be zero, as poses and LiDAR are those of that "
                "very camera. Restore the file."
            )
        x, y, z = (float(value) for value in t_left - t_right)
        if x <= 0:
            raise BenchError(
                f"{self.perspective}: P_rect_01 gives a baseline of {x:.4f} m; it must be positive. Restore the file."
            )
        self._require_size(size)
        fx, fy, cx, cy = (float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return StereoCamera(*size, fx=fx, fy=fy, cx=cx, cy=cy, right_position=(x, y, z))

    def _require_size(self, size: tuple[int, int]) -> None:
        written, line = named_numbers(self.perspective, "S_rect_00", 2)
        if tuple(written.astype(int)) != size:
            raise BenchError(
                f"The images are {size[0]}x{size[1]} pixels, but {self.perspective}, line {line}, is for "
                f"{written[0]:.0f}x{written[1]:.0f}. Use the images as KITTI-360 has them, in data_rect."
            )

    def T_rect0_cam0(self) -> Float:
        """4x4: the rectifying rotation R_rect_00."""
        return named_rotation(self.perspective, "R_rect_00")

    def T_pose_rect0(self) -> Float:
        """4x4, metres: from the rectified left camera to the GPS/IMU frame, image_00 of calib_cam_to_pose R_rect^-1."""
        path = self._folder / "calib_cam_to_pose.txt"
        values, line = named_numbers(path, "image_00", 12)
        return rigid(values.reshape(3, 4), path, line) @ se3.inverse(self.T_rect0_cam0())

    def T_rect0_velodyne(self) -> Float:
        """4x4, metres: from the LiDAR to the rectified left camera, R_rect_00 (calib_cam_to_velo)^-1."""
        path = self._folder / "calib_cam_to_velo.txt"
        lines = read_lines(path)
        if len(lines) != 1:
            raise BenchError(f"{path} has {len(lines)} lines, expected one with 12 numbers. Restore the file.")
        values = parse_numbers(lines[0], 12, path, 1)
        return self.T_rect0_cam0() @ se3.inverse(rigid(values.reshape(3, 4), path, 1))


@dataclass(frozen=True)
class NumberedPoses:
    """Poses T_world_rect0 (N, 4, 4) float64 of the frames ``ids`` (N,), which increase; ``path`` is their file."""

    ids: npt.NDArray[np.int64]
    T: Float
    path: Path

    def has(self, ids: Sequence[int] | npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Which of the frames have a pose of their own."""
        return np.isin(np.asarray(ids), self.ids)

    def of(self, number: int) -> Float | None:
        """The 4x4 pose of one frame, or None."""
        row = int(np.searchsorted(self.ids, number))
        return self.T[row] if row < len(self.ids) and self.ids[row] == number else None

    def interpolated(self, ids: npt.NDArray[np.int64]) -> Float:
        """Poses (M, 4, 4) of frames from the first to the last that has one: its own, or that between its neighbours.

        Between two poses the centre goes straight and the camera turns about one axis, evenly in the frame number:
        images come at an even rate, and it is only poses that are left out.
        """
        after = np.minimum(np.searchsorted(self.ids, ids), len(self.ids) - 1)
        before = np.maximum(after - 1, 0)
        a, b = self.T[before], self.T[after]
        fraction = (ids - self.ids[before]) / np.maximum(self.ids[after] - self.ids[before], 1)
        T = se3.interpolate(a, b, fraction)
        own = self.has(ids)
        T[own] = self.T[np.searchsorted(self.ids, ids[own])]
        return T


def read_cam0_poses(folder: Path, calibration: Kitti360Calibration) -> NumberedPoses | None:
    """T_world_rect0 from ``cam0_to_world.txt``, else from ``poses.txt`` and the calibration; None without either file.

    Where both are there, they must agree. Raises ``BenchError`` with file and line for what is malformed.
    """
    of_camera, of_vehicle = folder / "cam0_to_world.txt", folder / "poses.txt"
    camera = _read_numbered(of_camera, 17) if of_camera.is_file() else None
    if not of_vehicle.is_file():
        return camera
    vehicle = _read_numbered(of_vehicle, 13)
    vehicle = NumberedPoses(vehicle.ids, vehicle.T @ calibration.T_pose_rect0(), vehicle.path)
    if camera is None:
        return vehicle
    _require_agreement(camera, vehicle)
    return camera


def _require_agreement(camera: NumberedPoses, vehicle: NumberedPoses) -> None:
    _, rows, others = np.intersect1d(camera.ids, vehicle.ids, assume_unique=True, return_indices=True)
    if not len(rows):
        raise BenchError(
            f"{camera.path} and {vehicle.path} have no frame in common: they are of two sequences. Restore both from "
            "KITTI-360's data_poses.zip."
        )
    sample = np.unique(np.linspace(0, len(rows) - 1, _SAMPLE).astype(int))
    off = np.abs(camera.T[rows[sample]] - vehicle.T[others[sample]]).max(axis=(1, 2))
    if off.max() > _AGREEMENT:
        number = int(camera.ids[rows[sample[int(np.argmax(off))]]])
        raise BenchError(
            f"{camera.path}, frame {number}: the pose differs by {off.max():.3g} from that of {vehicle.path} with "
            "calib_cam_to_pose.txt and R_rect_00. The files are of different versions or sequences: restore "
            "data_poses and calibration, or move one of the two pose files away."
        )


def _read_numbered(path: Path, columns: int) -> NumberedPoses:
    """Lines of a frame number and a matrix, row by row, of 3x4 or 4x4 numbers; rotations made orthonormal."""
    table = _read_table(path, columns)
    ids = table[:, 0].astype(np.int64)
    wrong = (ids != table[:, 0]) | (ids < 0)
    if wrong.any():
        raise BenchError(
            f"{path}, line {int(np.argmax(wrong)) + 1}: '{table[np.argmax(wrong), 0]:g}' is no frame number. Expected "
            f"a frame number and {columns - 1} numbers of its pose; restore the file."
        )
    steps = np.flatnonzero(np.diff(ids) <= 0)
    if len(steps):
        row = int(steps[0]) + 1
        raise BenchError(
            f"{path}, line {row + 1}: frame {ids[row]} comes after frame {ids[row - 1]}; frame numbers must increase. "
            "Restore the file."
        )
    T = np.tile(np.eye(4), (len(table), 1, 1))
    T[:, :3] = table[:, 1:13].reshape(-1, 3, 4)
    # The fourth row, where the file has one.
    off = np.abs(table[:, 13:] - np.array([0.0, 0.0, 0.0, 1.0])[: columns - 13]).max(axis=1, initial=0.0)
    wrong = ~is_rotation(T[:, :3, :3]) | (off > 1e-9)
    if wrong.any():
        raise BenchError(
            f"{path}, line {int(np.argmax(wrong)) + 1}: this is no rigid pose (rotation and translation, row by row). "
            "Restore the file."
        )
    return NumberedPoses(ids, se3.orthonormalise(T), path)


def _read_table(path: Path, columns: int) -> Float:
    lines = read_lines(path)
    if not lines:
        raise BenchError(f"{path} is empty. Restore it from KITTI-360's data_poses.zip, or remove it.")
    try:
        table = np.loadtxt(lines, comments=None, ndmin=2)
    except ValueError:
        table = np.empty((0, 0))
    if table.shape == (len(lines), columns) and np.isfinite(table).all():
        return table
    # Ten times slower, but it says which line is wrong.
    return np.stack([parse_numbers(text, columns, path, line) for line, text in enumerate(lines, start=1)])


def read_image_times(path: Path, ids: Sequence[int], there: Sequence[int]) -> Float:
    """Seconds (N,) of the images ``ids`` since the file's first line; lines are ``2013-05-28 08:46:02.904519000``.

    Line i is image i. A file of a sequence that begins later may instead have one line for each image from the first
    to the last of those ``there``. Raises ``BenchError`` with the line for what is malformed or does not increase.
    """
    lines = read_lines(path)
    first, last = there[0], there[-1]
    if len(lines) > last:
        rows = np.array(ids)
    elif len(lines) == last - first + 1:
        rows = np.array(ids) - first
    else:
        raise BenchError(
            f"{path} has {len(lines)} lines, but the images go from {first} to {last}: expected {last + 1} lines or "
            "more. Restore the file, or move it away to take 10 images per second for granted."
        )
    needed = np.concatenate([[0], rows])
    times = np.array([_time(lines[row], path, row + 1) for row in needed])
    late = np.flatnonzero(np.diff(times[1:]) <= np.timedelta64(0))
    if len(late):
        raise BenchError(
            f"{path}, line {rows[late[0] + 1] + 1}: the time does not increase after line {rows[late[0]] + 1}. Restore "
            "the file."
        )
    # Differences of integer nanoseconds are exact; dates in seconds as float64 would not be.
    return np.asarray((times[1:] - times[0]) / np.timedelta64(1, "s"), dtype=np.float64)


def _time(text: str, path: Path, line: int) -> np.datetime64:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of time zones, which numpy guesses at
            time = np.datetime64(text.strip(), "ns")
        known = not np.isnat(time)
    except (ValueError, Warning):
        known = False
    if not known:
        raise BenchError(
            f"{path}, line {line}: '{text.strip()[:40]}' is no time; expected 'YYYY-MM-DD hh:mm:ss.nnnnnnnnn'. "
            "Restore the file."
        )
    return time
