"""Disparities of a made-up pair whose shift is known to an eighth of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench.tracking.features import Features, OrbExtractor, Pyramid
from bench.tracking.stereo_match import match_stereo
from bench.types import StereoCamera

CAMERA = StereoCamera(640, 240, 400.0, 400.0, 319.5, 119.5, (0.5, 0.0, 0.0))


def shifted_pair(eighths: int) -> tuple[np.ndarray, np.ndarray]:
    """Every 8th column of one fine picture, and the same ``eighths`` columns on: a shift of ``eighths / 8`` pixels."""
    noise = np.random.default_rng(0).normal(size=(240, 8 * 800)).astype(np.float32)
    fine = cv2.GaussianBlur(noise, (0, 0), sigmaX=12.0, sigmaY=1.5)
    fine = 128 + 50 * fine / fine.std()
    left, right = fine[:, : 8 * 640 : 8], fine[:, eighths : eighths + 8 * 640 : 8]
    return tuple(np.clip(np.rint(x), 0, 255).astype(np.uint8) for x in (left, right))  # type: ignore[return-value]


def extract(left: np.ndarray, right: np.ndarray) -> tuple[Features, Features, Pyramid, Pyramid]:
    extractor = OrbExtractor(1500)
    (left_features, left_pyramid), (right_features, right_pyramid) = (extractor.extract(x) for x in (left, right))
    return left_features, right_features, left_pyramid, right_pyramid


@pytest.mark.parametrize("eighths", [99, 160, 283])
def test_subpixel_shift_is_measured(eighths: int) -> None:
    matched = extract(*shifted_pair(eighths))
    disparity = match_stereo(*matched, CAMERA)
    error = disparity[np.isfinite(disparity)] - eighths / 8
    assert len(error) > 0.5 * len(matched[0])
    assert abs(np.median(error)) < 0.03
    assert np.median(np.abs(error)) < 0.08
    assert np.mean(np.abs(error) > 1.0) < 0.02


def test_right_camera_that_is_off_by_millimetres() -> None:
    """The disparity must place a point where the true two cameras see it, not where an ideal pair would."""
    camera = StereoCamera(640, 240, 400.0, 400.0, 319.5, 119.5, (0.5, 0.0, 0.02))
    matched = extract(*shifted_pair(160))
    ideal, true = match_stereo(*matched, CAMERA), match_stereo(*matched, camera)
    k = int(np.flatnonzero(np.isfinite(true))[0])
    depth = camera.fx * camera.baseline / true[k]
    point = np.array([(matched[0].xy[k, 0] - camera.cx) / camera.fx * depth, 0.0, depth, 1.0])
    in_right = np.linalg.inv(camera.T_left_right) @ point
    u_right = camera.fx * in_right[0] / in_right[2] + camera.cx
    assert matched[0].xy[k, 0] - u_right == pytest.approx(ideal[k], abs=1e-9)


def test_blank_right_image_gives_no_disparity() -> None:
    left, _ = shifted_pair(160)
    assert np.isnan(match_stereo(*extract(left, np.zeros_like(left)), CAMERA)).all()
