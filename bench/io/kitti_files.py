"""Text files of a KITTI odometry sequence: ``calib.txt`` and ``times.txt`` (poses: ``trajectory_io``)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from bench.errors import BenchError
from bench.io.text_files import read_text
from bench.types import Float, StereoCamera


def read_lines(path: Path) -> list[str]:
    """The file's lines without trailing empty ones; ``BenchError`` if it can't be read as text."""
    return read_text(path).rstrip().splitlines()


def parse_numbers(text: str, count: int, path: Path, line: int) -> Float:
    """``count`` finite numbers separated by blanks, (count,) float64; ``BenchError`` with the line number otherwise."""
    words = text.split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        bad = next(word for word in words if not _is_number(word))[:40]
        raise BenchError(f"{path}, line {line}: '{bad}' is not a number. Restore the file from the data set.") from None
    if len(values) != count:
        raise BenchError(f"{path}, line {line}: {len(values)} numbers, expected {count}. Restore the file.")
    if not np.isfinite(values).all():
        raise BenchError(f"{path}, line {line}: not all numbers are finite (NaN or infinity). Restore the file.")
    return values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


_MATRIX = re.compile(r"P_rect_0(?P<raw>\d)|P(?P<odometry>\d)|Tr|Tr_velo_to_cam")
_RAW_FILE = "calib_cam_to_cam.txt"


class KittiCalibration:
    """``calib.txt``: projections P0..P3 and, where the file has it, the LiDAR's ``Tr``; or KITTI raw's P_rect_00..03.

    A projection is P_i = K [I | t_i] with t_i = inv(K) P_i[:, 3], and x_cam_i = x_cam0 + t_i. All three components of
    t_i count: the colour cameras' y and z are millimetres, and P_i[0, 3] / f is off by 0.5 % of the baseline.
    """

    def __init__(self, path: Path) -> None:
        """Read the file; raises ``BenchError`` with the line number where a line is malformed."""
        self.path = path
        self._names: list[str] = []
        self._matrices: dict[str, Float] = {}
        for line, text in enumerate(read_lines(path), start=1):
            key, colon, rest = text.partition(":")
            if not text.strip():
                continue
            if not colon:
                raise BenchError(f"{path}, line {line}: expected 'NAME: 12 numbers'. Restore the file.")
            self._names.append(key.strip())
            # Other lines are of other lengths: KITTI raw's of the cameras before rectification, for example.
            if found := _MATRIX.fullmatch(key.strip()):
                camera = found["raw"] or found["odometry"]
                name = key.strip() if camera is None else f"P{camera}"
                self._matrices[name] = parse_numbers(rest, 12, path, line).reshape(3, 4)
            elif key.strip() == "R0_rect":
                self._matrices["R0_rect"] = parse_numbers(rest, 9, path, line).reshape(3, 3)

    @classmethod
    def in_folders(cls, *folders: Path) -> KittiCalibration:
        """That of the first folder which has a ``calib.txt`` or KITTI raw's ``calib_cam_to_cam.txt``."""
        places = [folder / name for folder in folders for name in ("calib.txt", _RAW_FILE)]
        return cls(next((path for path in places if path.is_file()), places[0]))

    def projection(self, index: int) -> tuple[Float, Float]:
        """K (3, 3) and t_i (3,) in metres of camera ``index``; ``BenchError`` if P``index`` is absent or singular."""
        P = self._matrices.get(f"P{index}")
        if P is None:
            have = ", ".join(self._names) or "nothing"
            raise BenchError(
                f"{self.path} has no line 'P{index}:' or 'P_rect_0{index}:' (it has {have}), which the camera pair "
                "needs. Take calib.txt from KITTI's data_odometry_calib.zip, or choose the other dataset.camera."
            )
        K = P[:, :3]
        if not (K[0, 0] > 0 and K[1, 1] > 0 and np.allclose(K[2], [0, 0, 1]) and abs(K[0, 1]) < 1e-9):
            raise BenchError(f"{self.path}: P{index} is not the projection of a rectified camera. Restore the file.")
        return K, np.linalg.solve(K, P[:, 3]).astype(np.float64)

    def stereo_camera(self, left: int, right: int, size: tuple[int, int]) -> StereoCamera:
        """The pair of these two cameras, whose images have this (width, height) in pixels; ``BenchError`` if none."""
        K, t_left = self.projection(left)
        K_right, t_right = self.projection(right)
        if not np.allclose(K, K_right, atol=1e-6):
            raise BenchError(f"{self.path}: P{left} and P{right} differ in K; a rectified pair shares it.")
        x, y, z = (float(value) for value in t_left - t_right)
        if x <= 0:
            raise BenchError(f"{self.path}: P{left} and P{right} give a baseline of {x:.4f} m; it must be positive.")
        fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return StereoCamera(*size, fx=fx, fy=fy, cx=cx, cy=cy, right_position=(x, y, z))

    def T_cam0_velodyne(self) -> Float:
        """4x4 rigid transform from the LiDAR's frame to cam0's; ``BenchError`` if ``Tr`` is absent."""
        # Some converted copies call the line as KITTI's other benchmarks do; there it leads to the camera
        # before rectification, and R0_rect follows.
        Tr = self._matrices.get("Tr", self._matrices.get("Tr_velo_to_cam"))
        if Tr is None:
            raise BenchError(
                f"{self.path} has no line 'Tr:' although there are velodyne scans. Unpack KITTI's "
                "data_odometry_calib.zip, whose calib.txt has it, or move the velodyne folder away."
            )
        if "Tr" not in self._matrices:
            Tr = self._matrices.get("R0_rect", np.eye(3)) @ Tr
        return np.vstack([Tr, [0.0, 0.0, 0.0, 1.0]])


def read_kitti_times(path: Path) -> Float:
    """Timestamps (N,) in seconds, strictly increasing; raises ``BenchError`` with the line number."""
    lines = read_lines(path)
    times = np.array([parse_numbers(text, 1, path, line)[0] for line, text in enumerate(lines, start=1)])
    steps = np.flatnonzero(np.diff(times) <= 0)
    if len(steps):
        raise BenchError(f"{path}, line {steps[0] + 2}: the time does not increase. Restore the file.")
    return times
