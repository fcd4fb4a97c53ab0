"""SGBM against a shift that is known exactly, KITTI 2015's laser disparities, KITTI 06's LiDAR and the street."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.contracts.stereo import StereoBackbone
from bench.errors import BenchError
from bench.registry import build, lookup
from bench.types import Image, Map
from plugins.datasets.kitti import Kitti, KittiConfig
from plugins.datasets.street import Street, StreetConfig
from plugins.stereo.sgbm import Sgbm, SgbmConfig

SHIFT = 21.375


def shifted_pair(shift: float) -> tuple[Image, Image]:
    """A random picture and the same seen ``shift`` pixels further left, by the phase in Fourier space (float64)."""
    rng = np.random.default_rng(0)
    height, width = 120, 400
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    spectrum = np.fft.rfft2(rng.standard_normal((height, width))) * np.exp(-((frequency / 0.12) ** 2))
    spectrum[:, -1] = 0
    turned = spectrum * np.exp(2j * np.pi * np.fft.rfftfreq(width) * shift)
    left, right = np.fft.irfft2(spectrum, s=(height, width)), np.fft.irfft2(turned, s=(height, width))
    scale = 45.0 / left.std()
    as_image = [np.clip(np.rint(128 + scale * part), 0, 255).astype(np.uint8) for part in (left, right)]
    return cv2.cvtColor(as_image[0], cv2.COLOR_GRAY2RGB), cv2.cvtColor(as_image[1], cv2.COLOR_GRAY2RGB)


@pytest.mark.parametrize("settings", [{}, {"mode": "sgbm"}, {"full_check": True}, {"color": True}])
def test_finds_a_known_shift(settings: dict[str, Any]) -> None:
    disparity = Sgbm(SgbmConfig(**settings)).disparity(*shifted_pair(SHIFT))
    assert disparity.dtype == np.float32
    assert disparity.shape == (120, 400)
    # Also in the first num_disparities columns, as far as the right image reaches.
    seen = disparity[:, 25:]
    assert np.isfinite(seen).mean() > 0.97
    # Its parabola pulls towards whole pixels, by a fifth of one at most.
    assert np.nanmedian(np.abs(seen - SHIFT)) < 0.2
    assert np.nanmax(np.abs(seen - SHIFT)) < 1.0


def test_unmatched_stays_unknown() -> None:
    left, right = shifted_pair(SHIFT)
    right[40:80, 100:300] = np.random.default_rng(1).integers(0, 256, (40, 200, 3), dtype=np.uint8)
    disparity = Sgbm(SgbmConfig()).disparity(left, right)
    spoiled = disparity[46:74, 140:300]
    assert np.isnan(spoiled).mean() > 0.8
    assert not (disparity <= 0).any()


def kitti_2015(test_data: Path) -> tuple[Image, Image, Map]:
    root = test_data / "kitti2015_sample"
    left, right = (cv2.imread(str(root / side / "000046_10.png"))[..., ::-1] for side in ("image_2", "image_3"))
    truth = cv2.imread(str(root / "disp_occ_0" / "000046_10.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) / 256
    truth[truth == 0] = np.nan
    return np.ascontiguousarray(left), np.ascontiguousarray(right), truth


@pytest.mark.parametrize(
    ("full_check", "epe", "bad", "density"), [(False, 0.8, 0.018, 0.94), (True, 0.72, 0.012, 0.92)]
)
def test_kitti_2015(test_data: Path, full_check: bool, epe: float, bad: float, density: float) -> None:
    left, right, truth = kitti_2015(test_data)
    disparity = Sgbm(SgbmConfig(full_check=full_check)).disparity(left, right)
    error = np.abs(disparity - truth)[np.isfinite(truth)]
    filled = np.isfinite(error)
    assert filled.mean() > density
    assert error[filled].mean() < epe
    assert (error[filled] > 3).mean() < bad


def test_kitti_06_against_lidar(kitti_root: Path) -> None:
    kitti = Kitti(KittiConfig(root=str(kitti_root), sequence="06", frames="4:5"))
    depth = Sgbm(SgbmConfig()).depth(kitti.frame(0), 0, kitti.camera).depth
    lidar = kitti.lidar_depth(0)
    assert lidar is not None
    both = np.isfinite(depth) & np.isfinite(lidar)
    assert both.sum() > 0.85 * np.isfinite(lidar).sum()
    assert np.median(np.abs(kitti.camera.fx * kitti.camera.baseline * (1 / depth[both] - 1 / lidar[both]))) < 0.5
    assert np.median(depth[both] / lidar[both]) == pytest.approx(1.0, abs=0.008)


def test_street_depth_is_near_the_exact_depth() -> None:
    street = Street(StreetConfig(frames=6, width=640, height=192))
    depth, exact = Sgbm(SgbmConfig()).depth(street.frame(5), 5, street.camera).depth, street.true_depth(5)
    both = np.isfinite(depth) & np.isfinite(exact)
    assert both.sum() > 0.75 * np.isfinite(exact).sum()
    error = np.abs(street.camera.fx * street.camera.baseline * (1 / depth[both] - 1 / exact[both]))
    assert np.median(error) < 0.2
    assert (error > 3).mean() < 0.03


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"num_disparities": 100}, "num_disparities=100 must be a positive multiple of 16, for example 112"),
        ({"block_size": 4}, "block_size=4 must be odd"),
        ({"mode": "3wy"}, "mode='3wy' .* Did you mean '3way'"),
        ({"p2": 4}, "p1 < p2"),
        ({"lr_max_diff": 0}, "lr_max_diff=0 must be at least 1"),
    ],
)
def test_wrong_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Sgbm(SgbmConfig(**settings))


def test_is_registered() -> None:
    assert isinstance(build(lookup("stereo", "sgbm").config(name="sgbm"), "stereo"), StereoBackbone)
