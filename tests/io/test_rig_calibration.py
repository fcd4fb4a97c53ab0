"""Every format and model gives back the rig that was written; what is wrong in a file is said."""

from __future__ import annotations

import re
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.io.rig_calibration import RigCalibration, read_rig
from tests.datasets.rig_disk import FORMATS, LEFT, T_right_left, right_of

SIZE = (640, 192)


def read_back(given: dict[str, str], size: tuple[int, int] = SIZE) -> RigCalibration:
    second = given.get("second_calibration")
    return read_rig(
        Path(given["calibration"]),
        None if second is None else Path(second),
        size,
        given.get("model", ""),
        float(given.get("unit_m", 1)),
    )


@pytest.mark.parametrize("model", LEFT)
@pytest.mark.parametrize("name", FORMATS)
def test_a_rig_is_read_as_it_was_written(name: str, model: str, tmp_path: Path) -> None:
    left, right, T = LEFT[model], right_of(LEFT[model]), T_right_left(0.3)
    rig = read_back(FORMATS[name](tmp_path, left, right, T))
    for found, written in ((rig.left, left), (rig.right, right)):
        assert astuple(found)[:-1] == astuple(written)[:-1]  # all but where it stands
    np.testing.assert_allclose(rig.T_right_left, T, atol=1e-9)


def edited(path: str, old: str, new: str) -> None:
    text, count = re.subn(old, new, Path(path).read_text(), count=1)
    assert count == 1
    Path(path).write_text(text)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("Kalibr", "resolution: .*", "resolution: [1280, 384]", r"cam0 is for images of 1280x384 pixels, and"),
        ("Kalibr", "camera_model: pinhole", "camera_model: omni", "cam0: the camera_model 'omni' is not read"),
        ("Kalibr", "distortion_model: radtan", "distortion_model: fov", "the distortion model 'fov' is none of radtan"),
        ("Kalibr", "(?s)cam1:.*", "", "lacks cam0 or cam1"),
        ("Kalibr", "T_cn_cnm1", "T_cam_imu", r"camchain.yaml: T_cn_cnm1 is missing"),
        ("Kalibr", "intrinsics: .*", "intrinsics: [1, 2]", "intrinsics has 2 numbers, expected 4"),
        ("Kalibr", "distortion_coeffs: .*", "distortion_coeffs: [a]", "distortion_coeffs holds something that is no"),
        ("Kalibr", "^", "!!python/object:os.system x\n", "can't be read as YAML"),
        ("Kalibr", "(?s).*", "just text", "is no calibration: expected names and values"),
        ("Kalibr", "(?s).*", "a: 1", r"has none of M1, K1, .* \(it has a\)"),
        ("OpenCV", "M1:", "M9:", "has none of M1, K1, cameraMatrix1"),
        ("OpenCV", "(?s)R: .*", "", r"lacks R and T of the right camera.*dataset\.second_calibration=FILE"),
        ("ROS", "projection_matrix:", "projection_matrix: [1]\nmore:", "projection_matrix is no matrix of 3x4"),
        ("ROS", "image_width: 640", "image_width: [six, 4]", "image_width holds something that is no number"),
        ("ROS", "rectification_matrix", "gone", r"left_info.yaml lacks rectification_matrix"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_file_is_said(name: str, old: str, new: str, message: str, tmp_path: Path) -> None:
    given = FORMATS[name](tmp_path, LEFT["radtan"], right_of(LEFT["radtan"]), T_right_left(0.3))
    edited(given["calibration"], old, new)
    with pytest.raises(BenchError, match=message) as caught:
        read_back(given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "without", "message"),
    [
        ("OpenCV", "model", r"four distortion coefficients may be .* dataset\.model=radtan or dataset\.model"),
        ("OpenCV in two files", "unit_m", r"the cameras are 300 m apart\. Is it of one camera, or in millimetres"),
        ("ROS", "second_calibration", r"is of one camera alone\. Give the right camera's camera_info too"),
        ("EuRoC", "second_calibration", r"is of one camera alone\. Give the right camera's sensor\.yaml too"),
    ],
)  # fmt: skip
def test_what_a_file_does_not_say_is_asked_for(name: str, without: str, message: str, tmp_path: Path) -> None:
    given = FORMATS[name](tmp_path, LEFT["radtan"], right_of(LEFT["radtan"]), T_right_left(0.3))
    del given[without]
    with pytest.raises(BenchError, match=message):
        read_back(given)
