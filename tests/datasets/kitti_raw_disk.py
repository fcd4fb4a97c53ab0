"""A day of KITTI raw with one drive, made up, as it lies on a disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.datasets.kitti_disk import HEIGHT, TR, WIDTH, projection, row, write_image

ANGLE = np.deg2rad(2.0)
R_RECT = np.array([[np.cos(ANGLE), 0, np.sin(ANGLE)], [0, 1, 0], [-np.sin(ANGLE), 0, np.cos(ANGLE)]])
IMU_IN_VELODYNE = np.array([-0.81, 0.32, -0.8])
LATITUDE = 49.0


def packet(east: float, north: float, yaw_deg: float) -> str:
    """Of a car ``east`` and ``north`` of 49 N, 8 E in metres of a Mercator plane; ``yaw_deg`` from east to north."""
    radius = 6378137.0 * np.cos(np.deg2rad(LATITUDE))
    y = np.arcsinh(np.tan(np.deg2rad(LATITUDE))) + north / radius
    latitude, longitude = np.rad2deg(np.arctan(np.sinh(y))), 8.0 + np.rad2deg(east / radius)
    return row(np.array([latitude, longitude, 110.0, 0.0, 0.0, np.deg2rad(yaw_deg), *np.zeros(24)])) + "\n"


def write_raw(root: Path, drive: str = "2011_09_26_drive_0005", numbers: range = range(5)) -> Path:
    """A car that drives north, 1 m a frame; returns the folder of the drive."""
    day = root / drive[:10]
    folder = day / f"{drive}_sync"
    for number in numbers:
        for camera in (2, 3):
            write_image(folder / f"image_0{camera}" / "data" / f"{number:010d}.png", 10 * number + camera)
        for name in ("oxts/data", "velodyne_points/data"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text(packet(0.0, 1.0 * number, 90.0))
        points = np.array([[10.0, 1.0, 0.5, 0.2], [20.0, -2.0, 0.0, 0.9]], dtype=np.float32)
        points.tofile(folder / "velodyne_points" / "data" / f"{number:010d}.bin")
    times = np.datetime64("2011-09-26T13:02:25.5", "ns") + np.arange(numbers.stop) * np.timedelta64(103_000_000, "ns")
    (folder / "image_02" / "timestamps.txt").write_text("".join(f"{time}\n".replace("T", " ") for time in times))
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.95e-02", "S_00: 1.392e+03 5.12e+02"]
    for camera in range(4):
        lines += [f"S_rect_0{camera}: {WIDTH:.6e} {HEIGHT:.6e}", f"R_rect_0{camera}: {row(R_RECT)}"]
        lines += [f"P_rect_0{camera}: {row(projection(camera))}"]
    (day / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    for name, R, t in (
        ("velo_to_cam", R_RECT.T @ TR[:, :3], R_RECT.T @ TR[:, 3]),
        ("imu_to_velo", np.eye(3), IMU_IN_VELODYNE),
    ):
        (day / f"calib_{name}.txt").write_text(f"calib_time: 15-Mar-2012\nR: {row(R)}\nT: {row(t)}\n")
    return folder
