"""KITTI raw: the odometry sequences' part of each drive, poses of the GPS/IMU, and what is said of damaged drives."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.errors import BenchError
from plugins.datasets.kitti_raw import KittiRaw, KittiRawConfig
from tests.datasets.kitti_disk import CX, CY, FX, T_CAM, TR, row
from tests.datasets.kitti_raw_disk import packet, write_raw

DRIVE = "2011_09_26_drive_0005"


def opened(root: Path, **settings: Any) -> KittiRaw:
    return KittiRaw(KittiRawConfig(root=str(root), **{"sequence": DRIVE, **settings}))


def test_a_drive(tmp_path: Path) -> None:
    write_raw(tmp_path)
    dataset = opened(tmp_path, frames="1:5")
    assert (dataset.label, dataset.numbers, dataset.remarks) == (f"kitti_raw/{DRIVE}", (1, 2, 3, 4), ())
    assert (dataset.camera.fx, dataset.camera.cx, dataset.camera.cy) == (FX, CX, CY)
    np.testing.assert_allclose(dataset.camera.right_position, np.subtract(T_CAM[2], T_CAM[3]), atol=1e-12)
    assert [dataset.frame(i).timestamp for i in range(2)] == [0.103, 0.206]
    assert opened(tmp_path / "2011_09_26", sequence=f"{DRIVE}_sync").numbers == (0, 1, 2, 3, 4)


def test_a_car_that_drives_north_moves_along_the_axis_that_its_camera_looks_along(tmp_path: Path) -> None:
    """TR turns the LiDAR's x to the camera's z. On the last frame the car has turned left by 3 degrees."""
    folder = write_raw(tmp_path)
    (folder / "oxts/data/0000000004.txt").write_text(packet(0.0, 4.0, 93.0))
    truth = opened(tmp_path).ground_truth()
    assert truth is not None
    assert (truth.T_world_cam[0] == np.eye(4)).all()
    np.testing.assert_allclose(truth.T_world_cam[:4, :3, 3], [[0, 0, z] for z in range(4)], atol=1e-6)
    turn = np.deg2rad(-3.0)  # y is down: to the left is negative
    expected = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    np.testing.assert_allclose(truth.T_world_cam[4, :3, :3], expected, atol=1e-9)
    # Where the camera is ahead of the GPS/IMU, it swings to the left when the car turns.
    assert truth.T_world_cam[4, 0, 3] < -1e-3


@pytest.mark.parametrize("uncurl", [False, True])
def test_a_scan_in_the_image(uncurl: bool, tmp_path: Path) -> None:
    """By hand: what stands to the left was measured before, by azimuth / 2 pi of a turn, in which the car went 1 m."""
    write_raw(tmp_path)
    depth = opened(tmp_path, uncurl=uncurl).lidar_depth(2)
    assert depth is not None
    expected = {}
    for point in ([10.0, 1.0, 0.5], [20.0, -2.0, 0.0]):
        point[0] -= np.arctan2(point[1], point[0]) / (2 * np.pi) if uncurl else 0.0
        x, y, z = TR[:, :3] @ point + TR[:, 3] + np.array(T_CAM[2])
        expected[round(FX * y / z + CY), round(FX * x / z + CX)] = z
    assert {(int(v), int(u)) for v, u in np.argwhere(np.isfinite(depth))} == set(expected)
    for pixel, z in expected.items():
        assert depth[pixel] == pytest.approx(z, rel=1e-6)


def test_odometry_08_begins_at_image_1100_of_its_drive_and_ends_before_the_drive(tmp_path: Path) -> None:
    write_raw(tmp_path, "2011_09_30_drive_0028", range(1098, 1104))
    dataset = opened(tmp_path, sequence="8")
    assert (dataset.label, dataset.numbers) == ("kitti_raw/08", (0, 1, 2, 3))
    assert dataset.frame(2).number == 2
    assert dataset.frame(2).timestamp == pytest.approx(1102 * 0.103)
    np.testing.assert_array_equal(
        dataset.frame(2).left, opened(tmp_path, sequence="2011_09_30_drive_0028").frame(4).left
    )
    truth = dataset.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == [0, 1, 2, 3]
    write_raw(tmp_path, "2011_09_30_drive_0016", range(269, 273))
    assert opened(tmp_path, sequence="04").numbers == (269, 270)


def test_scans_and_packets_that_are_missing_are_told(tmp_path: Path) -> None:
    folder = write_raw(tmp_path)
    (folder / "velodyne_points/data/0000000002.bin").unlink()
    (folder / "oxts/data/0000000003.txt").unlink()
    dataset = opened(tmp_path)
    assert dataset.remarks == (
        "1 of 5 frames have no LiDAR scan",
        "1 of 5 frames have no ground truth (no packet in oxts)",
    )
    assert dataset.lidar_depth(2) is None
    assert dataset.lidar_depth(3) is not None
    truth = dataset.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == [0, 1, 2, 4]


Damage = Callable[[Path], object]
CAMERAS, IMAGES = "calib_cam_to_cam.txt", f"{DRIVE}_sync/image_02"


def edited(name: str, old: str, new: str) -> Damage:
    def damage(day: Path) -> None:
        text, count = re.subn(old, new, (day / name).read_text(), count=1, flags=re.MULTILINE)
        assert count == 1
        (day / name).write_text(text)

    return damage


def without(name: str) -> Damage:
    return lambda day: (day / name).rename(day / "gone")


BAD: dict[str, tuple[Damage | None, dict[str, Any], str]] = {
    "no root": (None, {"root": ""}, "dataset.root"),
    "03": (None, {"sequence": "3"}, r"KITTI does not offer this drive, .* dataset=kitti dataset.sequence=03"),
    "11": (None, {"sequence": "11"}, "sequence=11: KITTI tells the drives of the sequences 00 to 10 only"),
    "no drive": (None, {"sequence": "drive five"}, "is neither a sequence of KITTI odometry"),
    "drive of another day": (
        None,
        {"sequence": "2011_09_30_drive_0005"},
        r"does not exist; .* holds 2011_09_26_drive_0005_sync\.",
    ),
    "unrectified": (
        lambda day: (day / f"{DRIVE}_sync").rename(day / f"{DRIVE}_extract"),
        {},
        r"_extract holds unrectified images\. Download",
    ),
    "grey": (None, {"camera": "gray"}, r"image_00/data does not exist"),
    "no calibration": (without(CAMERAS), {}, r"calib_cam_to_cam\.txt is missing\. Unpack .*2011_09_26_calib\.zip"),
    "no LiDAR's": (without("calib_velo_to_cam.txt"), {}, r"calib_velo_to_cam\.txt does not exist"),
    "no IMU's": (without("calib_imu_to_velo.txt"), {}, r"calib_imu_to_velo\.txt does not exist"),
    "no R_rect": (edited(CAMERAS, r"^R_rect_00: .*\n", ""), {}, r"no line 'R_rect_00:'"),
    "R_rect": (edited(CAMERAS, r"^R_rect_00: \S+", "R_rect_00: 2.0"), {}, r"line 5: .*not a rotation"),
    "size": (edited(CAMERAS, r"^S_rect_03: .*", "S_rect_03: 1242 375"), {}, r"64x24 .*line 13, is for 1242x375"),
    "baseline": (edited(CAMERAS, r"^P_rect_03:", "P_rect_02:"), {}, r"no line 'P3:' or 'P_rect_03:'"),
    "times": (
        edited(f"{IMAGES}/timestamps.txt", r":25.603.*", ":25.1"),
        {},
        r"timestamps\.txt, line 2: the time does not increase",
    ),
    "no time": (edited(f"{IMAGES}/timestamps.txt", r"\A.*", "noon"), {}, r"timestamps\.txt, line 1: 'noon' is no time"),
    "hole": (without(f"{IMAGES}/data/0000000002.png"), {}, "Frame 2 is missing in .*image_02"),
    "right": (without(f"{DRIVE}_sync/image_03/data/0000000002.png"), {}, r"image_03/data lacks frame 2"),
    "cut scan": (
        lambda day: (day / f"{DRIVE}_sync/velodyne_points/data/0000000001.bin").write_bytes(b"12345"),
        {},
        "0000000001.bin has 5 bytes",
    ),
    "cut packet": (
        edited(f"{DRIVE}_sync/oxts/data/0000000001.txt", r" \S+$", ""),
        {},
        r"0000000001\.txt, line 1: 29 numbers, expected 30",
    ),
    "angles in degrees": (
        lambda day: (day / f"{DRIVE}_sync/oxts/data/0000000001.txt").write_text(
            row(np.array([49, 8, 100, 0, 0, 90, *[0] * 24])) + "\n"
        ),
        {},
        r"0000000001\.txt: .* angles behind are not in radians",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_in_a_sentence(case: str, tmp_path: Path) -> None:
    damage, settings, message = BAD[case]
    write_raw(tmp_path)
    if damage is not None:
        damage(tmp_path / "2011_09_26")
    with pytest.raises(BenchError, match=message) as caught:
        KittiRaw(KittiRawConfig(**{"root": str(tmp_path), "sequence": DRIVE, **settings}))
    assert "\n" not in str(caught.value)
