"""EuRoC: real pairs rectified and tracked at rest, ground truth worked by hand, and what is said of damaged folders."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.errors import BenchError
from bench.geometry import se3
from bench.tracking.row_offset import row_offset
from plugins.datasets.euroc import Euroc, EurocConfig
from plugins.trackers.stereo_orb import StereoOrb, StereoOrbConfig
from tests.datasets.euroc_disk import HEADER, START, STEP, T_BODY_LEFT, T_LEFT_RIGHT, TRUTH, write_euroc, write_truth


def opened(root: Path, **settings: Any) -> Euroc:
    return Euroc(EurocConfig(root=str(root), **{"sequence": "V9_01_made_up", **settings}))


@pytest.mark.slow
def test_real_pairs_are_rectified_and_at_rest(test_data: Path) -> None:
    """The rows of matched corners, and a tracker that must not move, say whether the calibration is read as it is."""
    dataset = Euroc(EurocConfig(root=str(test_data / "euroc_mav")))
    assert (dataset.label, len(dataset), dataset.remarks) == ("euroc/V1_01_easy", 12, ())
    assert dataset.ground_truth() is None
    # As published for ORB-SLAM2; its own cut to the visible part is a quarter of a percent smaller.
    assert dataset.camera.baseline == pytest.approx(47.90639384423901 / 435.2046959714599, abs=1e-6)
    assert dataset.camera.fx == pytest.approx(435.2046959714599, rel=5e-3)
    tracker = StereoOrb(StereoOrbConfig())
    tracker.start(dataset)
    for position in range(12):
        frame = dataset.frame(position)
        assert frame.timestamp == pytest.approx(1403715273.262142976 + 0.05 * position, abs=1e-6)
        left, right = frame.pair("", "")
        if position % 4 == 0:
            assert row_offset(left, right) < 0.3
            # Exposed each for itself: the right image is a tenth darker, and must still be a pair.
            assert 1.05 < left.mean() / right.mean() < 1.2
        T = tracker.track(frame).T_world_cam
        assert T is not None
        assert np.linalg.norm(T[:3, 3]) < 0.005


def test_ground_truth_is_that_of_the_camera_at_the_images_times(tmp_path: Path) -> None:
    """The body goes 1 m/s along the world's y and turns about its z by 90 degrees an image; poses are between the
    images' times, and end before the last. Quaternions are w, x, y, z."""
    mav0 = write_euroc(tmp_path)
    write_truth(mav0)
    dataset = opened(tmp_path)
    assert dataset.remarks == ("1 of 4 frames have no ground truth, which covers a part of the flight",)
    truth = dataset.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == [0, 1, 2]
    np.testing.assert_allclose(truth.timestamps, (START + STEP * np.arange(3)) / 1e9, atol=1e-6)
    for k in range(3):
        c, s = [(1, 0), (0, 1), (-1, 0)][k]
        T_world_body = np.array([[c, -s, 0, 0], [s, c, 0, 0.05 * k], [0, 0, 1, 0], [0, 0, 0, 1]])
        expected = np.linalg.inv(T_BODY_LEFT) @ T_world_body @ T_BODY_LEFT
        np.testing.assert_allclose(truth.T_world_cam[k], expected, atol=1e-6)


def test_a_rectifying_rotation_is_part_of_the_pose(tmp_path: Path) -> None:
    """The body turns by 90 degrees about the baseline's own axis, which rectifying makes the camera's x axis, though
    the left camera is mounted askew to it by 6 degrees: so the ground truth is a turn about x."""
    mav0 = write_euroc(tmp_path, 2)
    askew = se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.0])), np.zeros(3))
    for camera, T in (("cam0", askew), ("cam1", T_LEFT_RIGHT)):
        path = mav0 / camera / "sensor.yaml"
        path.write_text(re.sub(r"data: .*", f"data: {T.ravel().tolist()}", path.read_text(), count=1))
    (mav0 / TRUTH).parent.mkdir()
    rows = f"{START},0,0,0,1,0,0,0,0\n{START + STEP},0,0,0,{np.sqrt(0.5)},{np.sqrt(0.5)},0,0,0\n"
    (mav0 / TRUTH).write_text(HEADER + "\n" + rows)
    truth = opened(tmp_path).ground_truth()
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam[1, :3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-6)


def test_times_in_seconds_are_the_same(tmp_path: Path) -> None:
    write_euroc(tmp_path / "ns")
    write_euroc(tmp_path / "s", seconds=True)
    assert [each.settings for each in Euroc.sequences_in(tmp_path / "s")] == [{"sequence": "V9_01_made_up"}]
    assert opened(tmp_path / "s").lacks() == ("no ground truth (state_groundtruth_estimate0/data.csv)",)
    times = [[data.frame(i).timestamp for i in range(4)] for data in (opened(tmp_path / "ns"), opened(tmp_path / "s"))]
    np.testing.assert_allclose(times[0], times[1], atol=1e-6)


def test_images_without_a_partner_are_left_out_and_told(tmp_path: Path) -> None:
    """V2_03 lacks hundreds of the right camera's images."""
    mav0 = write_euroc(tmp_path, 5)
    path = mav0 / "cam1" / "data.csv"
    path.write_text(path.read_text().replace(f"{START + 2 * STEP},{START + 2 * STEP}.png\n", ""))
    dataset = opened(tmp_path / "V9_01_made_up")
    assert dataset.label == "euroc/V9_01_made_up"
    assert dataset.numbers == (0, 1, 2, 3)
    assert dataset.remarks == ("1 images of cam0 and 0 of cam1 have no partner of the same time: left out",)
    assert dataset.frame(2).timestamp == pytest.approx((START + 3 * STEP) / 1e9, abs=1e-6)
    assert opened(tmp_path, scale=0.5, frames="1:3").camera.width == 32


Damage = Callable[[Path], object]


def edited(name: str, old: str, new: str) -> Damage:
    def damage(mav0: Path) -> None:
        text, count = re.subn(old, new, (mav0 / name).read_text(), count=1, flags=re.MULTILINE)
        assert count == 1
        (mav0 / name).write_text(text)

    return damage


def with_truth(text: str) -> Damage:
    def damage(mav0: Path) -> None:
        (mav0 / TRUTH).parent.mkdir()
        (mav0 / TRUTH).write_text(text)

    return damage


ROW = f"{START},0,0,0,1,0,0,0,0\n"
BAD: dict[str, tuple[Damage | None, dict[str, Any], str]] = {
    "no root": (None, {"root": "gone"}, "dataset.root=gone: this folder does not exist"),
    "other": (None, {"sequence": "MH_01"}, r"MH_01 holds no folder 'mav0'; .* has V9_01_made_up\. Choose one"),
    "no list": (lambda mav0: (mav0 / "cam1/data.csv").unlink(), {}, r"cam1/data.csv does not exist"),
    "no image": (
        lambda mav0: (mav0 / f"cam1/data/{START + STEP}.png").unlink(),
        {},
        rf"{START + STEP}\.png is missing",
    ),
    "outside": (
        edited("cam0/data.csv", r",1403\S+$", ",../../secret.png"),
        {},
        r"data\.csv, line 2: expected a time and",
    ),
    "time": (edited("cam0/data.csv", r"^1403\d+", "noon"), {}, r"line 2: 'noon' is no time"),
    "back": (edited("cam0/data.csv", rf"^{START},", f"{START + STEP},"), {}, r"line 3: the time is not after"),
    "strangers": (
        lambda mav0: [
            edited("cam1/data.csv", rf"^{START + k * STEP},", f"{START + k * STEP + 7},")(mav0) for k in range(4)
        ],
        {},
        r"no time of cam0/data\.csv is one of cam1",
    ),
    "no sensor": (lambda mav0: (mav0 / "cam1/sensor.yaml").unlink(), {}, r"sensor\.yaml does not exist"),
    "size": (
        edited("cam1/sensor.yaml", "64, 24", "752, 480"),
        {},
        "is for images of 752x480 pixels, and these",
    ),
    "T_BS": (edited("cam0/sensor.yaml", r"data: \[0.01", "data: [2.01"), {}, "T_BS is no rigid motion"),
    "omni": (edited("cam0/sensor.yaml", "pinhole", "omni"), {}, "the camera_model 'omni' is not read"),
    "swapped": (
        lambda mav0: [(mav0 / a).rename(mav0 / b) for a, b in (("cam0", "x"), ("cam1", "cam0"), ("x", "cam1"))],
        {},
        "the right camera lies on the left one's left",
    ),
    "quaternion": (
        with_truth(HEADER + "\n" + ROW.replace(",1,", ",2,")),
        {},
        "line 2: the quaternion is not of length",
    ),
    "header": (with_truth("#timestamp, x, y\n" + ROW), {}, "the header names no column p_RS_R_x"),
    "text": (with_truth(HEADER + "\n" + ROW.replace(",1,", ",one,")), {}, r"line 2: position or quaternion is no row"),
    "order": (with_truth(HEADER + "\n" + ROW + ROW), {}, "the times do not increase"),
    "another flight": (with_truth(HEADER + "\n" + ROW.replace("14037", "14047")), {}, "nowhere near the images'"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_in_a_sentence(case: str, tmp_path: Path) -> None:
    damage, settings, message = BAD[case]
    mav0 = write_euroc(tmp_path)
    if damage is not None:
        damage(mav0)
    with pytest.raises(BenchError, match=message) as caught:
        Euroc(EurocConfig(**{"root": str(tmp_path), "sequence": "V9_01_made_up", **settings}))
    assert "\n" not in str(caught.value)
