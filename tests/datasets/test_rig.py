"""A user's rig: the street as distorted cameras see it comes back as it was, in folders and videos."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.geometry import se3
from bench.tracking.row_offset import matched_rows
from bench.types import StereoCamera, StereoFrame
from plugins.datasets.euroc import Euroc, EurocConfig
from plugins.datasets.rig import Rig, RigConfig
from plugins.datasets.street import Street, StreetConfig
from tests.datasets.rig_disk import ASKEW, FORMATS, LEFT, T_right_left, right_of, taken_by


@pytest.fixture(scope="module")
def street() -> tuple[StereoCamera, StereoFrame]:
    dataset = Street(StreetConfig(frames=1, width=640, height=192))
    return dataset.camera, dataset.frame(0)


@pytest.fixture(scope="module")
def taken(street: tuple[StereoCamera, StereoFrame]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of each model of distortion: what the left and the right camera see."""
    camera, frame = street
    left, right = frame.pair("", "")
    return {
        model: (
            taken_by(distorted, ASKEW["left"], left, camera)[..., ::-1],
            taken_by(right_of(distorted), ASKEW["right"], right, camera)[..., ::-1],
        )
        for model, distorted in LEFT.items()
    }


Write = Callable[..., dict[str, Any]]


@pytest.fixture
def write_rig(
    street: tuple[StereoCamera, StereoFrame], taken: dict[str, tuple[np.ndarray, np.ndarray]], tmp_path: Path
) -> Write:
    """Writes pictures of one moment, ``count`` times, 0.2 s apart by their names; gives the settings that read them."""

    def write(model: str = "radtan", calibration: str = "Kalibr", count: int = 1) -> dict[str, Any]:
        for side, image in zip(("left", "right"), taken[model], strict=True):
            (tmp_path / side).mkdir()
            for number in range(count):
                assert cv2.imwrite(str(tmp_path / side / f"{1.5 + 0.2 * number:.3f}.png"), image)
        cameras = LEFT[model], right_of(LEFT[model])
        given = FORMATS[calibration](tmp_path, *cameras, T_right_left(street[0].baseline))
        unit = {"unit_m": float(given["unit_m"])} if "unit_m" in given else {}
        return {"left": str(tmp_path / "left"), "right": str(tmp_path / "right"), **given, **unit}

    return write


@pytest.mark.parametrize("model", LEFT)
@pytest.mark.parametrize("calibration", FORMATS)
def test_the_street_comes_back(
    calibration: str, model: str, street: tuple[StereoCamera, StereoFrame], write_rig: Write
) -> None:
    """Corners are where the undistorted picture has them, turned to the rectified axes by the known rotation."""
    rig = Rig(RigConfig(**write_rig(model, calibration)))
    camera, original = street
    assert rig.camera.baseline == pytest.approx(camera.baseline, rel=1e-6)
    said = re.fullmatch(r"rectification: matched corners are (\S+) px off their rows .*", rig.remarks[0])
    assert said is not None
    assert float(said[1]) < 0.3
    found = rig.frame(0)
    R_rect_street = rig._rectification.R_rect_left @ se3.so3_exp(ASKEW["left"])
    H = rig.camera.intrinsics @ R_rect_street @ np.linalg.inv(camera.intrinsics)
    for image, expected in zip(found.pair("", ""), original.pair("", ""), strict=True):
        warped = cv2.warpPerspective(expected, H, (640, 192))
        start, there = matched_rows(warped, image)
        assert len(start) > 100
        assert np.median(np.linalg.norm(there - start, axis=1)) < 0.3


def test_times_crop_scale_and_grey(write_rig: Write, tmp_path: Path) -> None:
    given = write_rig(count=3)
    for path in (tmp_path / "left").glob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    whole = Rig(RigConfig(**given))
    assert (whole.numbers, whole.label) == ((0, 1, 2), f"rig/{tmp_path.name}")
    assert [whole.frame(i).timestamp for i in range(3)] == pytest.approx([1.5, 1.7, 1.9])
    grey = whole.frame(0).left
    assert (grey[..., 0] == grey[..., 2]).all()
    (tmp_path / "times.csv").write_text("time [s],file\n10.0,a\n10.5,b\n12.0,c\n")
    cut = Rig(RigConfig(**given, crop=[101, 20, 400, 120], scale=0.5, frames="1:3", times=str(tmp_path / "times.csv")))
    assert [cut.frame(i).timestamp for i in range(2)] == [10.5, 12.0]
    assert (cut.camera.width, cut.camera.height, cut.camera.fx) == (200, 60, whole.camera.fx / 2)
    # A pixel of the cropped, halved image is the mean of 2x2 of the whole one.
    block = grey[20:140, 101:501].astype(float).reshape(60, 2, 200, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(cut.frame(0).left, block, atol=0.51)
    assert (cut.camera.cx + 0.5) * 2 + 101 - 0.5 == pytest.approx(whole.camera.cx)
    focal = Rig(RigConfig(**given, focal=450.0))
    assert focal.camera.fx == 450.0


def test_poses_are_turned_to_the_rectified_camera(write_rig: Write, tmp_path: Path) -> None:
    """The street camera stands at 0 and then 1 m ahead; the rig's left camera is askew to it."""
    given = write_rig(count=2)
    R = se3.so3_exp(ASKEW["left"])
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, :3], T[1, 2, 3] = R.T, 1.0
    np.savetxt(tmp_path / "poses.txt", T[:, :3].reshape(2, 12))
    rig = Rig(RigConfig(**given, poses=str(tmp_path / "poses.txt")))
    truth = rig.ground_truth()
    assert truth is not None
    # Rectified, its x axis is the street's: only a turn about x remains, the same for both frames.
    np.testing.assert_allclose(truth.T_world_cam[:, :3, 0], [[1, 0, 0]] * 2, atol=1e-9)
    np.testing.assert_allclose(truth.T_world_cam[:, :3, 3], [[0, 0, 0], [0, 0, 1]], atol=1e-12)
    assert Rig(RigConfig(**given)).ground_truth() is None


def write_video(path: Path, images: list[np.ndarray], rate: float = 20.0) -> str:
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), rate, (width, height))
    for image in images:
        writer.write(image)
    writer.release()
    return str(path)


def test_one_video_with_both_images(write_rig: Write, tmp_path: Path) -> None:
    """FFV1 loses nothing but what YUV rounds. Each frame is brighter by four, and the right image darker by 30."""
    grey = np.full((192, 640, 3), 90, np.uint8)
    both = np.hstack([grey, grey - 30])
    video = write_video(tmp_path / "both.avi", [cv2.add(both, (4.0 * k,) * 3) for k in range(12)])
    rig = Rig(RigConfig(**{**write_rig(), "left": video, "right": ""}))
    assert (len(rig), rig.frame(3).timestamp) == (12, pytest.approx(3 / 20))
    for number in (0, 10, 9, 1, 10, 2):  # forwards, from memory, and from the start again
        for image, value in zip(rig.frame(number).pair("", ""), (90, 60), strict=True):
            assert np.abs(image[5:-5, 5:-5].astype(int) - (value + 4 * number)).max() <= 2


def test_two_videos(write_rig: Write, tmp_path: Path) -> None:
    given = write_rig()
    for side, count in (("left", 4), ("right", 3)):
        given[side] = write_video(tmp_path / f"{side}.avi", [cv2.imread(str(tmp_path / side / "1.500.png"))] * count)
    rig = Rig(RigConfig(**given, rate=5.0))
    assert rig.numbers == (0, 1, 2)
    assert rig.remarks[0] == "the left video has 4 frames and the right one 3: the first 3 are pairs"
    assert rig.remarks[1].startswith("rectification: matched corners are 0.")
    assert rig.frame(2).timestamp == pytest.approx(0.4)


def test_a_wrong_calibration_is_refused(
    street: tuple[StereoCamera, StereoFrame], write_rig: Write, tmp_path: Path
) -> None:
    """The right camera's turn left out: a degree and a half, twelve rows."""
    given = write_rig()
    T = T_right_left(street[0].baseline)
    T[:3, :3] = np.eye(3)
    FORMATS["Kalibr"](tmp_path, LEFT["radtan"], right_of(LEFT["radtan"]), T)
    with pytest.raises(BenchError, match=r"matched corners are \d+\.\d px off their rows .* this rig, at this size"):
        Rig(RigConfig(**given))


def test_the_first_camera_may_be_the_right_one(
    street: tuple[StereoCamera, StereoFrame], write_rig: Write, tmp_path: Path
) -> None:
    given = write_rig()
    expected = Rig(RigConfig(**given))
    T = np.linalg.inv(T_right_left(street[0].baseline))
    FORMATS["Kalibr"](tmp_path, right_of(LEFT["radtan"]), LEFT["radtan"], T)
    with pytest.raises(BenchError, match="the right camera lies on the left one's left"):
        Rig(RigConfig(**given))
    swapped = Rig(RigConfig(**given, swapped=True))
    np.testing.assert_allclose(swapped.camera.right_position, expected.camera.right_position, atol=1e-9)
    np.testing.assert_array_equal(swapped.frame(0).left, expected.frame(0).left)


def test_the_real_euroc_pairs_by_their_sensor_yaml(test_data: Path) -> None:
    mav0 = test_data / "euroc_mav" / "V1_01_easy" / "mav0"
    images = {side: str(mav0 / camera / "data") for side, camera in (("left", "cam0"), ("right", "cam1"))}
    second = str(mav0 / "cam1" / "sensor.yaml")
    rig = Rig(RigConfig(**images, calibration=str(mav0 / "cam0/sensor.yaml"), second_calibration=second, frames="3:4"))
    euroc = Euroc(EurocConfig(root=str(test_data / "euroc_mav"), frames="3:4"))
    np.testing.assert_array_equal(rig.frame(0).right, euroc.frame(0).right)
    assert rig.camera == euroc.camera
    assert rig.frame(0).timestamp == pytest.approx(euroc.frame(0).timestamp, abs=1e-6)
    assert float(rig.remarks[-1].split()[4]) < 0.3


def test_what_can_not_be_judged_is_told(write_rig: Write, tmp_path: Path) -> None:
    given = write_rig()
    for path in tmp_path.glob("*/*.png"):
        cv2.imwrite(str(path), np.full((192, 640, 3), 90, np.uint8))
    assert Rig(RigConfig(**given)).remarks == ("rectification can't be judged: 0 corners match in 1 pairs",)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"left": ""}, "dataset.left is not set"),
        ({"right": ""}, "dataset.right is not set"),
        ({"calibration": ""}, "dataset.calibration is not set"),
        ({"calibration": "gone.yaml"}, "The calibration gone.yaml does not exist"),
        ({"crop": [600, 0, 100, 50]}, "reaches out of the rectified images of 640x192"),
        ({"crop": [1, 2, 3]}, r"dataset\.crop=\[1, 2, 3\] must be"),
        ({"model": "fish"}, "dataset.model"),
        ({"scale": 2.0}, "dataset.scale=2.0 must lie between"),
        ({"left": "VIDEO"}, "dataset.left is a video, and dataset.right=.* is none"),
        ({"left": "VIDEO", "right": ""}, "no video in MP4, MOV, AVI, MKV or WebM"),
        ({"left": "BROKEN", "right": ""}, "is no video that can be decoded"),
    ],
)
def test_wrong_settings_are_said(settings: dict[str, Any], message: str, write_rig: Write, tmp_path: Path) -> None:
    given = write_rig()
    (tmp_path / "VIDEO").write_text("#EXTM3U\nhttp://localhost/a.ts\n")
    (tmp_path / "BROKEN").write_bytes(b"RIFF1234AVI LIST")
    changed = {k: str(tmp_path / v) if v in ("VIDEO", "BROKEN") else v for k, v in settings.items()}
    with pytest.raises(BenchError, match=message):
        Rig(RigConfig(**{**given, **changed}))
