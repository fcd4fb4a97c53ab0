"""SSIM as other evaluators compute it: zero-padded as in the code of 3D Gaussian Splatting, and multi-scale.

Images are (H, W, 3) float32 in [0, 1]. ``bench.evaluation.image.ssim`` is the fast one for 8-bit images.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.types import Float

Color = npt.NDArray[np.float32]

RADIUS = 5
"""Of the Gaussian window: 11 taps, sigma 1.5. A window that must lie in the image leaves this border unscored."""
MS_SSIM_MINIMUM_SIDE = 161
"""The smallest of the five scales must still hold a window."""

_SIGMA = 1.5
_TAPS = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / _SIGMA) ** 2)
_TAPS /= _TAPS.sum()
# K1 = 0.01, K2 = 0.03, data range 1.
_C1, _C2 = 0.01**2, 0.03**2
_SCALE_WEIGHTS = np.array([0.0448, 0.2856, 0.3001, 0.2363, 0.1333])


def ssim_map(image: Color, reference: Color) -> Float:
    """SSIM of every pixel and channel whose window lies in the image: (H - 10, W - 10, 3) float64.

    Raises ``BenchError`` for images of less than 11 pixels on a side.
    Source: Wang et al., "Image quality assessment", IEEE TIP 2004, Eq. 13.
    """
    return _maps(image, reference)[0]


def padded_ssim_map(image: Color, reference: Color) -> Float:
    """SSIM of every pixel and channel, (H, W, 3) float64, black beyond the image: its mean is that of 3DGS's code."""
    return ssim_map(_with_black_border(image), _with_black_border(reference))


def ssim_3dgs(image: Color, reference: Color) -> float:
    """Mean SSIM with zero padding, as in the training code of 3D Gaussian Splatting and in MonoGS's evaluation.

    Source: Kerbl et al., "3D Gaussian Splatting", 2023, released code.
    """
    return float(np.mean(padded_ssim_map(image, reference)))


def ms_ssim(image: Color, reference: Color) -> float:
    """Multi-scale SSIM over five scales, mean over the channels, as the package ``pytorch_msssim`` computes it.

    A scale is the 2x2 mean of the one before, odd sides with a line of zeros before them; negative parts count as 0.
    Raises ``BenchError`` for images of less than 161 pixels on a side.
    Source: Wang et al., "Multi-scale structural similarity for image quality assessment", Asilomar 2003.
    """
    if min(image.shape[:2]) < MS_SSIM_MINIMUM_SIDE:
        raise BenchError(
            f"MS-SSIM needs images of at least {MS_SSIM_MINIMUM_SIDE} pixels on a side; these are "
            f"{image.shape[1]}x{image.shape[0]}."
        )
    parts = []
    for scale in range(len(_SCALE_WEIGHTS)):
        if scale:
            image, reference = _halved(image), _halved(reference)
        similarity, contrast = _maps(image, reference)
        is_last = scale == len(_SCALE_WEIGHTS) - 1
        parts.append(np.mean(similarity if is_last else contrast, axis=(0, 1)))
    return float(np.mean(np.prod(np.maximum(parts, 0.0) ** _SCALE_WEIGHTS[:, None], axis=0)))


def _maps(image: Color, reference: Color) -> tuple[Float, Float]:
    """SSIM, and its part without the brightness ("contrast and structure"), where the window lies in the image."""
    if image.shape != reference.shape or min(image.shape[:2]) < 2 * RADIUS + 1:
        raise BenchError(
            f"SSIM needs two images of the same size and at least 11x11 pixels; these are {image.shape[1]}x"
            f"{image.shape[0]} and {reference.shape[1]}x{reference.shape[0]}."
        )
    # In float64: of flat bright parts float32 leaves an error of 5e-6, as much as the last digit others report.
    x, y = image.astype(np.float64), reference.astype(np.float64)
    mean_x, mean_y = _blurred(x), _blurred(y)
    products, squares = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
    # Only the sum of the two variances enters, so four filters do instead of five.
    covariance = _blurred(x * y) - products
    variances = _blurred(x * x + y * y) - squares
    contrast = (2 * covariance + _C2) / (variances + _C2)
    return (2 * products + _C1) / (squares + _C1) * contrast, contrast


def _blurred(values: Float) -> Float:
    blurred = cv2.sepFilter2D(values, cv2.CV_64F, _TAPS, _TAPS)
    return np.asarray(blurred[RADIUS:-RADIUS, RADIUS:-RADIUS], dtype=np.float64)


def _with_black_border(values: Color) -> Color:
    return np.pad(values, ((RADIUS, RADIUS), (RADIUS, RADIUS), (0, 0)))


def _halved(values: Color) -> Color:
    """Means of 2x2 pixels; an odd side first gets a line of zeros at its start."""
    values = np.pad(values, ((values.shape[0] % 2, 0), (values.shape[1] % 2, 0), (0, 0)))
    rows = values[0::2] + values[1::2]
    return np.asarray((rows[:, 0::2] + rows[:, 1::2]) * np.float32(0.25))
