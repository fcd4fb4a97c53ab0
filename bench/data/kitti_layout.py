"""Any data set written as KITTI's odometry benchmark lays out a sequence, for what reads files of that layout alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.io.atomic import write_bytes, write_image, write_text
from bench.types import Float, Map, StereoCamera

# The axes of KITTI's LiDAR (x ahead, y left, z up) in the camera's.
_R_CAM_VELODYNE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def write_kitti(dataset: Dataset, root: Path, sequence: str, report: Callable[[int, int], None] | None = None) -> Path:
    """Write the colour pair, calibration, times, and poses and scans where known; returns the sequence's folder.

    Frames become 0, 1, 2 ... A scan holds the points that the LiDAR's depth has in the left image. The folder must not
    hold another sequence; ``calib.txt`` is written last. Raises ``BenchError``.
    """
    folder, poses = root / "sequences" / sequence, root / "poses" / f"{sequence}.txt"
    if (folder / "calib.txt").exists():
        raise BenchError(f"{folder} holds a sequence already. Remove it, or choose another folder.")
    dataset.require_right("KITTI's layout", "a stereo data set")
    times = []
    for position in range(len(dataset)):
        frame = dataset.frame(position)
        left, right = frame.pair("KITTI's layout", "a stereo data set")
        for camera, image in ((2, left), (3, right)):
            target = folder / f"image_{camera}" / f"{position:06d}.png"
            target.parent.mkdir(parents=True, exist_ok=True)
            write_image(target, image)
        depth = dataset.lidar_depth(position)
        if depth is not None:
            target = folder / "velodyne" / f"{position:06d}.bin"
            target.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(target, scan_of(depth, dataset.camera).tobytes())
        times.append(frame.timestamp)
        if report is not None:
            report(position + 1, len(dataset))
    write_text(folder / "times.txt", "".join(f"{time - times[0]:.9e}\n" for time in times))
    truth = dataset.ground_truth()
    if truth is not None:
        poses.parent.mkdir(parents=True, exist_ok=True)
        rows = {number: row for row, number in enumerate(truth.numbers.tolist())}
        unknown = np.full((4, 4), np.nan)
        of_frame = [truth.T_world_cam[rows[number]] if number in rows else unknown for number in dataset.numbers]
        write_text(poses, "".join(_row(T[:3]) for T in of_frame))
    write_text(folder / "calib.txt", _calibration(dataset.camera))
    return folder


def _calibration(camera: StereoCamera) -> str:
    left = np.column_stack([camera.intrinsics, np.zeros(3)])
    right = camera.intrinsics @ np.column_stack([np.eye(3), -np.array(camera.right_position)])
    Tr = np.column_stack([_R_CAM_VELODYNE, np.zeros(3)])
    matrices = {"P0": left, "P1": right, "P2": left, "P3": right, "Tr": Tr}
    return "".join(f"{name}: {_row(matrix)}" for name, matrix in matrices.items())


def _row(matrix: Float) -> str:
    return " ".join(f"{value:.12e}" for value in matrix.ravel()) + "\n"


def scan_of(depth: Map, camera: StereoCamera) -> np.ndarray:
    """The points (N, 4) float32 of a depth map in the LiDAR's axes, with reflectance 0: each at its pixel's centre."""
    v, u = np.nonzero(np.isfinite(depth))
    z = depth[v, u].astype(np.float64)
    points = np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
    return np.column_stack([points @ _R_CAM_VELODYNE, np.zeros(len(z))]).astype(np.float32)
