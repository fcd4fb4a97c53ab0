"""PSNR and SSIM: values worked by hand, and scikit-image as an independent oracle on random and real images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from bench.errors import BenchError
from bench.evaluation.image import psnr, ssim


def grey(values: np.ndarray) -> np.ndarray:
    """(H, W) in [0, 1] to an 8-bit RGB image."""
    return np.repeat(np.round(values * 255).astype(np.uint8)[..., None], 3, axis=2)


def oracle_ssim(a: np.ndarray, b: np.ndarray) -> float:
    return float(
        structural_similarity(
            a.astype(np.float64) / 255,
            b.astype(np.float64) / 255,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=1,
            channel_axis=-1,
        )
    )


def test_psnr_is_joint_over_the_channels_not_their_mean() -> None:
    """Errors of 20, 10 and 40 grey levels: mean square 2100/3; the mean of the three channels' PSNRs would differ."""
    reference = np.full((4, 5, 3), 100, np.uint8)
    image = reference + np.array([20, 10, 40], np.uint8)
    assert psnr(image, reference) == pytest.approx(10 * np.log10(255**2 / 700), abs=1e-12)
    of_channels = np.mean([20 * np.log10(255 / error) for error in (20, 10, 40)])
    assert psnr(image, reference) < of_channels - 1.0


def test_psnr_of_the_fact_sheet_case() -> None:
    """0.5 everywhere, errors 0.1, 0.05, 0.2: 17.5696 dB; 8-bit values are rounded, which shifts it by hundredths."""
    reference = np.full((2, 2, 3), 128, np.uint8)
    image = reference + np.round(255 * np.array([0.1, 0.05, 0.2])).astype(np.uint8)
    assert psnr(image, reference) == pytest.approx(17.569620, abs=0.05)


def test_psnr_of_identical_images_is_the_cap() -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 20, 3), dtype=np.uint8)
    assert psnr(image, image.copy()) == 100.0
    assert ssim(image, image.copy()) == pytest.approx(1.0, abs=1e-6)


def test_psnr_agrees_with_scikit_image() -> None:
    a, b = np.random.default_rng(1).integers(0, 256, (2, 370, 1226, 3), dtype=np.uint8)
    assert psnr(a, b) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=255), abs=1e-9)


def test_ssim_of_two_constants() -> None:
    """Without variance SSIM is (2ab + C1) / (a^2 + b^2 + C1); 0.4 and 0.6 are whole grey levels."""
    expected = (2 * 0.4 * 0.6 + 1e-4) / (0.4**2 + 0.6**2 + 1e-4)
    assert ssim(grey(np.full((32, 32), 0.6)), grey(np.full((32, 32), 0.4))) == pytest.approx(expected, abs=1e-5)


def test_ssim_of_a_checkerboard_and_its_inverse() -> None:
    board = np.indices((32, 32)).sum(axis=0) % 2
    assert ssim(grey(board), grey(1 - board)) == pytest.approx(-0.99640647, abs=1e-5)


def test_ssim_scores_no_border() -> None:
    """A step against grey: 0.24074 with the border left out, 0.27404 with zero padding (the value of 3DGS code)."""
    step = (np.arange(32) >= 16).astype(float) * np.ones((32, 1))
    value = ssim(grey(step), grey(np.full((32, 32), 0.5)))
    # 0.5 is stored as 128/255.
    assert value == pytest.approx(0.24073924, abs=2e-3)
    assert value == pytest.approx(oracle_ssim(grey(step), grey(np.full((32, 32), 0.5))), abs=1e-5)


def test_ssim_of_a_ramp_is_near_the_fact_sheet_value() -> None:
    ramp = np.linspace(0, 1, 32) * np.ones((32, 1))
    assert ssim(grey(0.9 * ramp), grey(ramp)) == pytest.approx(0.98994800, abs=1e-3)


@pytest.mark.parametrize("size", [(11, 11), (12, 40), (74, 30), (75, 64), (139, 33), (150, 161)])
def test_ssim_agrees_with_scikit_image_on_random_images(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(size[0])
    a = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    smooth = cv2.GaussianBlur(a, (0, 0), 1.0)
    assert ssim(smooth, a) == pytest.approx(oracle_ssim(smooth, a), abs=1e-5)


def test_ssim_agrees_with_scikit_image_on_flat_images_with_faint_noise() -> None:
    """Where variances are tiny, float32 has the least digits left."""
    rng = np.random.default_rng(5)
    a, b = (np.uint8(250) + rng.integers(0, 3, (2, 100, 100, 3), dtype=np.uint8)).astype(np.uint8)
    assert ssim(a, b) == pytest.approx(oracle_ssim(a, b), abs=1e-5)


def test_ssim_agrees_with_scikit_image_on_real_images(kitti_root: Path) -> None:
    folder = kitti_root / "sequences" / "06" / "image_2"
    a, b = (cv2.imread(str(folder / name)) for name in ("000000.png", "000001.png"))
    assert ssim(a, b) == pytest.approx(oracle_ssim(a, b), abs=1e-5)
    softened = cv2.GaussianBlur(a, (0, 0), 0.8)
    assert ssim(softened, a) == pytest.approx(oracle_ssim(softened, a), abs=1e-5)


def test_images_that_can_not_be_compared_are_named() -> None:
    image = np.zeros((20, 30, 3), np.uint8)
    with pytest.raises(BenchError, match=r"\(20, 30, 3\) uint8 with a reference \(20, 29, 3\)"):
        psnr(image, image[:, 1:])
    with pytest.raises(BenchError, match="float32"):
        ssim(image.astype(np.float32), image)
    with pytest.raises(BenchError, match="at least 11x11 pixels; these are 30x10"):
        ssim(image[:10], image[:10])
