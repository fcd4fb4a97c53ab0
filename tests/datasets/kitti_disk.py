"""A made-up KITTI odometry root on disk, to be damaged by tests."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 64, 24
FX, CX, CY = 50.0, 31.0, 11.5
# t_i of the four cameras, in metres; P_i[:, 3] = K t_i.
T_CAM = {0: (0.0, 0.0, 0.0), 1: (-0.5, 0.0, 0.0), 2: (0.06, -0.001, 0.005), 3: (-0.47, 0.002, 0.003)}
# KITTI's LiDAR axes (x forward, y left, z up) to the camera's, shifted.
TR = np.array([[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, -0.2], [1.0, 0.0, 0.0, -0.3]])


def projection(camera: int) -> np.ndarray:
    K = np.array([[FX, 0, CX], [0, FX, CY], [0, 0, 1]])
    return K @ np.column_stack([np.eye(3), T_CAM[camera]])


def row(matrix: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in np.asarray(matrix).ravel())


def write_image(path: Path, seed: int, width: int = WIDTH, height: int = HEIGHT) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    assert cv2.imwrite(str(path), pixels)


def write_kitti(root: Path, frames: int = 4, sequence: str = "04") -> Path:
    """A root with one sequence: colour pair, scans, calibration, times, poses; returns the sequence's folder."""
    folder = root / "sequences" / sequence
    for number in range(frames):
        for camera in (2, 3):
            write_image(folder / f"image_{camera}" / f"{number:06d}.png", 10 * number + camera)
        (folder / "velodyne").mkdir(exist_ok=True)
        points = np.array([[10.0, 1.0, 0.5, 0.2], [20.0, -2.0, 0.0, 0.9]], dtype=np.float32)
        points.tofile(folder / "velodyne" / f"{number:06d}.bin")
    lines = [f"P{i}: {row(projection(i))}" for i in range(4)] + [f"Tr: {row(TR)}"]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    (folder / "times.txt").write_text("".join(f"{0.1 * n:.6e}\n" for n in range(frames)))
    poses = [np.column_stack([np.eye(3), [0.0, 0.0, 1.0 * n]]) for n in range(frames)]
    (root / "poses").mkdir(parents=True, exist_ok=True)
    (root / "poses" / f"{sequence}.txt").write_text("".join(row(pose) + "\n" for pose in poses))
    return folder
