"""Rectification against the formulas of the distortion models, and its measure against a known shift."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.geometry import se3
from bench.geometry.rectification import DistortedCamera, Rectification
from bench.tracking.row_offset import row_offset

T_RIGHT_LEFT = se3.compose(se3.so3_exp(np.array([0.03, -0.05, 0.02])), np.array([-0.2, 0.01, -0.005]))
RADTAN = DistortedCamera(320, 240, 200.0, 202.0, 161.0, 118.0, "radtan", (-0.28, 0.07, 2e-4, 2e-5), "cam0")
FISHEYE = DistortedCamera(320, 240, 150.0, 151.0, 158.0, 121.0, "equidistant", (-0.01, 0.02, -0.01, 0.002), "cam0")
RIGHT = {"fx": 198.0, "cx": 157.0, "where": "cam1"}


def stored(camera: DistortedCamera, rays: np.ndarray) -> np.ndarray:
    """Pixels (N, 2): Brown, 1966, and Kannala and Brandt, 2006."""
    x, y = (rays[:, :2] / rays[:, 2:]).T
    d, r = camera.distortion, np.hypot(x, y)
    if camera.model == "radtan":
        radial = 1 + d[0] * r**2 + d[1] * r**4
        xd = x * radial + 2 * d[2] * x * y + d[3] * (r**2 + 2 * x**2)
        yd = y * radial + d[2] * (r**2 + 2 * y**2) + 2 * d[3] * x * y
    else:
        angle = np.arctan(r)
        scale = angle * (1 + sum(k * angle ** (2 * i + 2) for i, k in enumerate(d))) / r
        xd, yd = x * scale, y * scale
    return np.column_stack([camera.fx * xd + camera.cx, camera.fy * yd + camera.cy])


@pytest.mark.parametrize("left", [RADTAN, FISHEYE], ids=["radtan", "equidistant"])
@pytest.mark.parametrize("focal", [None, 170.0])
def test_points_are_seen_where_the_maps_say_and_in_one_row(left: DistortedCamera, focal: float | None) -> None:
    right = replace(left, **RIGHT)
    rectification = Rectification(left, right, T_RIGHT_LEFT, focal)
    camera = rectification.camera
    assert camera.baseline == pytest.approx(np.linalg.norm(T_RIGHT_LEFT[:3, 3]), rel=1e-12)
    if focal is not None:
        assert (camera.fx, camera.fy) == (focal, focal)
    # Whole pixels of the rectified left image with a depth such that the right one sees them at whole pixels too.
    rng = np.random.default_rng(0)
    u, v, disparity = rng.integers(60, 260, 200), rng.integers(40, 200, 200), rng.integers(2, 40, 200)
    z = camera.fx * camera.baseline / disparity
    points = np.column_stack([(u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z])
    in_left = points @ rectification.R_rect_left  # R^T p
    in_right = in_left @ T_RIGHT_LEFT[:3, :3].T + T_RIGHT_LEFT[:3, 3]
    for side, rays, columns, maps in zip(
        (left, right), (in_left, in_right), (u, u - disparity), rectification.maps, strict=True
    ):
        np.testing.assert_allclose(np.column_stack([m[v, columns] for m in maps]), stored(side, rays), atol=2e-3)


def test_no_pixel_is_black() -> None:
    white = np.full((240, 320, 3), 255, np.uint8)
    for image in Rectification(RADTAN, replace(RADTAN, **RIGHT), T_RIGHT_LEFT).pair(white, white):
        assert image[1:-1, 1:-1].min() == 255


@pytest.mark.parametrize(
    ("change", "T", "message"),
    [
        ({}, se3.inverse(T_RIGHT_LEFT), r"cam0 and cam1: the right camera lies on the left one's left\. Exchange"),
        ({}, se3.compose(np.eye(3), np.array([0.0, -0.2, 0.0])), "one camera is above the other"),
        ({}, se3.compose(se3.so3_exp(np.array([0.0, 1.5, 0.0])), np.array([-0.2, 0, 0])), "must be turned by"),
        ({"width": 640}, T_RIGHT_LEFT, "cam0 is for 320x240 pixels, and cam1 for 640x240"),
        ({"model": "omni"}, T_RIGHT_LEFT, "cam1: the distortion model 'omni' is none of radtan, equidistant"),
        ({"distortion": (0.1,)}, T_RIGHT_LEFT, "cam1: 1 distortion coefficients; the model radtan has 4 or 5 or"),
        ({"cx": 400.0}, T_RIGHT_LEFT, "cam1: fx, fy, cx, cy = 198, 202, 400, 118 is no camera of 320x240"),
        ({"fx": np.nan}, T_RIGHT_LEFT, "cam1: fx, fy, cx, cy = nan"),
    ],
)
def test_what_is_no_stereo_rig_is_refused(change: dict[str, object], T: np.ndarray, message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Rectification(RADTAN, replace(RADTAN, **{**RIGHT, **change}), T)


@pytest.mark.parametrize("rows", [0.0, 0.4, -2.7])
def test_the_row_offset_is_that_of_the_images(rows: float) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8)
    left = cv2.GaussianBlur(noise, (0, 0), 2.0)
    left = cv2.normalize(left, None, 0, 255, cv2.NORM_MINMAX)
    right = cv2.warpAffine(left, np.array([[1, 0, -13.3], [0, 1, rows]]), (320, 240))
    pair = (np.repeat(image[..., None], 3, axis=2) for image in (left, right))
    assert row_offset(*pair) == pytest.approx(abs(rows), abs=0.05)
    flat = np.full((240, 320, 3), 90, np.uint8)
    assert np.isnan(row_offset(flat, flat))
