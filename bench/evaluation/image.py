"""PSNR and SSIM of 8-bit RGB images."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.types import Image

PSNR_CAP_DB = 100.0

# scikit-image truncates the Gaussian at 3.5 sigma: 11 taps for sigma = 1.5; the border of 5 pixels is not scored.
_SIGMA = 1.5
_RADIUS = 5
_TAPS = np.exp(-0.5 * (np.arange(-_RADIUS, _RADIUS + 1) / _SIGMA) ** 2)
_KERNEL = np.round(_TAPS / _TAPS.sum() * 2**25) / 2**25
# Multiples of 2^-25 are exact in float32, and so the taps sum to exactly 1: a sum off by 1e-7 would be as much of the
# brightness taken for variance, which shows where an image is bright and flat.
_KERNEL[_RADIUS] += 1.0 - _KERNEL.sum()
_KERNEL = _KERNEL.astype(np.float32)
# So few rows at a time stay in the cache: on a KITTI image a third of the time of doing it at once.
_STRIP_ROWS = 64
# K1 = 0.01, K2 = 0.03, data range 1.
_C1, _C2 = 0.01**2, 0.03**2


def psnr(image: Image, reference: Image) -> float:
    """PSNR in dB of two uint8 images (H, W, 3), joint over pixels and channels, capped at 100 dB (identical images).

    >>> black = np.zeros((4, 4, 3), np.uint8)
    >>> round(psnr(black + np.uint8(51), black), 3)  # 20 log10(255 / 51)
    13.979
    """
    _check(image, reference)
    squared = cv2.norm(image, reference, cv2.NORM_L2SQR)
    if squared == 0.0:
        return PSNR_CAP_DB
    return min(PSNR_CAP_DB, float(10.0 * np.log10(255.0**2 * image.size / squared)))


def ssim(image: Image, reference: Image) -> float:
    """SSIM of two uint8 images (H, W, 3): Gaussian window, mean over channels and pixels but a border of 5.

    The definition is scikit-image's ``structural_similarity(gaussian_weights=True, sigma=1.5,
    use_sample_covariance=False, data_range=1, channel_axis=-1)``; this is about ten times as fast. Raises
    ``BenchError`` for images of less than 11 pixels on a side.
    Source: Wang et al., "Image quality assessment", IEEE TIP 2004, Eq. 13.

    >>> image = np.random.default_rng(0).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    >>> round(ssim(image, image), 6), round(ssim(image, 255 - image), 1) < 0
    (1.0, True)
    """
    _check(image, reference)
    if min(image.shape[:2]) < 2 * _RADIUS + 1:
        raise BenchError(f"SSIM needs images of at least 11x11 pixels; these are {image.shape[1]}x{image.shape[0]}.")
    height = image.shape[0]
    total = 0.0
    for top in range(0, height - 2 * _RADIUS, _STRIP_ROWS):
        rows = slice(top, min(top + _STRIP_ROWS + 2 * _RADIUS, height))
        total += _ssim_sum(image[rows], reference[rows])
    return total / ((height - 2 * _RADIUS) * (image.shape[1] - 2 * _RADIUS) * image.shape[2])


def _ssim_sum(image: Image, reference: Image) -> float:
    """Sum of the SSIM map of all channels, without the border of 5 pixels."""
    # Less the mean brightness: float32 keeps more digits of the variances, which are small differences of squares.
    level = np.mean(cv2.mean(reference)[:3]) / 255
    x, y = _less(image, level), _less(reference, level)
    mean_x, mean_y = _blurred(x), _blurred(y)
    products = mean_x * mean_y
    squares = mean_x * mean_x + mean_y * mean_y
    # Only the sum of the two variances enters, so four filters do instead of five.
    covariance = _blurred(x * y) - products
    variances = _blurred(x * x + y * y) - squares
    # Back from the shifted means: mu = mean + level.
    sums = np.float32(level) * (mean_x + mean_y) + np.float32(level**2)
    numerator = (2 * (products + sums) + _C1) * (2 * covariance + _C2)
    denominator = (squares + 2 * sums + _C1) * (variances + _C2)
    return float(np.sum(numerator / denominator, dtype=np.float64))


def _less(image: Image, level: float) -> npt.NDArray[np.float32]:
    """From 0..255 to 0..1, less ``level``."""
    return np.asarray(cv2.addWeighted(image, 1 / 255, image, 0.0, -level, dtype=cv2.CV_32F), dtype=np.float32)


def _blurred(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    blurred = cv2.sepFilter2D(values, cv2.CV_32F, _KERNEL, _KERNEL)
    return np.asarray(blurred[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS], dtype=np.float32)


def _check(image: Image, reference: Image) -> None:
    if image.shape != reference.shape or image.dtype != np.uint8 or reference.dtype != np.uint8:
        raise BenchError(
            f"Can't compare an image {image.shape} {image.dtype} with a reference {reference.shape} {reference.dtype}; "
            "both must be uint8 of the same size."
        )
