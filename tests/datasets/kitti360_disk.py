"""A made-up KITTI-360 root on disk, with the calibration that the data set publishes, to be damaged by tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 1408, 376
F, CX, CY, BF = 552.554261, 682.049453, 238.769549, 328.318735
# Published: image_00 (not rectified) to the LiDAR.
CAM_TO_VELO = np.array(
    [
        [0.04307104361, -0.08829286498, 0.995162929, 0.8043914418],
        [-0.999004371, 0.007784614041, 0.04392796942, 0.2993489574],
        [-0.01162548558, -0.9960641394, -0.08786966659, -0.1770225824],
    ]
)
# Worked by hand: camera axes (right, down, ahead) to the vehicle's (ahead, right, down); 1.5 m ahead, 0.6 m up.
CAM_TO_POSE = np.array([[0.0, 0.0, 1.0, 1.5], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, -0.6]])
# The rectifying rotation: 5 degrees about the camera's y axis. (The real one is below one degree.)
ANGLE = np.deg2rad(5.0)
R_RECT = np.array([[np.cos(ANGLE), 0, np.sin(ANGLE)], [0, 1, 0], [-np.sin(ANGLE), 0, np.cos(ANGLE)]])

Draw = Callable[[int, int], np.ndarray]


def numbers(matrix: np.ndarray) -> str:
    return " ".join(f"{value:.12e}" for value in np.asarray(matrix, dtype=float).ravel())


def homogeneous(matrix: np.ndarray) -> np.ndarray:
    return np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])


def drive_of(sequence: str) -> str:
    return f"2013_05_28_drive_{sequence}_sync"


def noise(width: int, height: int) -> Draw:
    """Random pictures of this size."""

    def draw(number: int, side: int) -> np.ndarray:
        return np.random.default_rng(2 * number + side).integers(0, 256, (height, width, 3), dtype=np.uint8)

    return draw


def write_calibration(
    root: Path,
    P: Sequence[np.ndarray] | None = None,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    R_rect: np.ndarray = R_RECT,
) -> None:
    folder = root / "calibration"
    folder.mkdir(parents=True, exist_ok=True)
    K = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]])
    P = P or [np.column_stack([K, [0, 0, 0]]), np.column_stack([K, [-BF, 0, 0]])]
    lines = ["calib_time: 28-May-2013 12:00:00", "corner_dist: 1.0"]
    for i in range(2):
        lines += [f"S_0{i}: 1.392e+03 5.12e+02", f"D_0{i}: -3.6e-01 2.0e-01 0 0 0"]
        lines += [f"S_rect_0{i}: {size[0]:.6e} {size[1]:.6e}", f"R_rect_0{i}: {numbers(R_rect)}"]
        lines += [f"P_rect_0{i}: {numbers(P[i])}"]
    (folder / "perspective.txt").write_text("\n".join(lines) + "\n")
    right = CAM_TO_POSE.copy()
    right[1, 3] += 0.59
    cameras = {"image_00": CAM_TO_POSE, "image_01": right}
    (folder / "calib_cam_to_pose.txt").write_text("".join(f"{k}: {numbers(v)}\n" for k, v in cameras.items()))
    (folder / "calib_cam_to_velo.txt").write_text(numbers(CAM_TO_VELO) + "\n")


def write_poses(root: Path, sequence: str, poses: Mapping[int, np.ndarray], R_rect: np.ndarray = R_RECT) -> None:
    """Both pose files from 4x4 poses of the vehicle; that of the camera by the data set's own formula."""
    folder = root / "data_poses" / drive_of(sequence)
    folder.mkdir(parents=True, exist_ok=True)
    to_rect = homogeneous(CAM_TO_POSE) @ np.linalg.inv(homogeneous(np.column_stack([R_rect, np.zeros(3)])))
    (folder / "poses.txt").write_text("".join(f"{n} {numbers(T[:3])}\n" for n, T in poses.items()))
    (folder / "cam0_to_world.txt").write_text("".join(f"{n} {numbers(T @ to_rect)}\n" for n, T in poses.items()))


def write_images(root: Path, sequence: str, ids: Sequence[int], draw: Draw, lines: int | None = None) -> None:
    """Images of both sides, and times of ``lines`` images (by default up to the last)."""
    raw = root / "data_2d_raw" / drive_of(sequence)
    lines = ids[-1] + 1 if lines is None else lines
    for side in range(2):
        folder = raw / f"image_0{side}" / "data_rect"
        folder.mkdir(parents=True)
        for number in ids:
            assert cv2.imwrite(str(folder / f"{number:010d}.png"), draw(number, side))
        start = np.datetime64("2013-05-28T08:46:02.904519123", "ns")
        times = start + np.arange(lines) * np.timedelta64(103_000_007, "ns")
        text = "".join(str(time).replace("T", " ") + "\n" for time in times)
        (folder.parent / "timestamps.txt").write_text(text)


def write_scan(root: Path, sequence: str, number: int, points: np.ndarray) -> Path:
    """Points (N, 3) in the LiDAR's frame."""
    folder = root / "data_3d_raw" / drive_of(sequence) / "velodyne_points" / "data"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{number:010d}.bin"
    np.column_stack([points, np.full(len(points), 0.5)]).astype(np.float32).tofile(path)
    return path


def vehicle_pose(x: float, y: float, heading: float = 90.0, z: float = 50.0) -> np.ndarray:
    """The vehicle (ahead, right, down) at (x, y, z) of a world whose z is up; ``heading`` in degrees from x to y."""
    c, s = np.cos(np.deg2rad(heading)), np.sin(np.deg2rad(heading))
    T = np.eye(4)
    T[:3] = np.array([[c, s, 0, x], [s, -c, 0, y], [0, 0, -1, z]])
    return T


def write_kitti360(
    root: Path,
    ids: Sequence[int] = range(6),
    with_pose: Sequence[int] = (1, 2, 4, 5),
    sequence: str = "0002",
    size: tuple[int, int] = (64, 24),
) -> Path:
    """A root with one sequence of small images, poses 1 m apart and a scan each; returns the folder of its images."""
    write_calibration(root, size=size)
    write_images(root, sequence, ids, noise(*size))
    write_poses(root, sequence, {n: vehicle_pose(2800.0, 6000.0 + n) for n in with_pose})
    for number in ids:
        write_scan(root, sequence, number, np.array([[10.0, 1.0, 0.5], [-3.0, 1.0, 0.0]]))
    return root / "data_2d_raw" / drive_of(sequence)
