"""SSIM as others compute it, against numbers worked out by hand, scikit-image, and float64 with scipy's filters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.ndimage import correlate1d
from skimage.metrics import structural_similarity

from bench.errors import BenchError
from bench.evaluation.ssim_flavours import Color, ms_ssim, padded_ssim_map, ssim_3dgs, ssim_map

Float = npt.NDArray[np.float64]


def flat(value: float, height: int, width: int) -> Color:
    return np.full((height, width, 3), value, np.float32)


def repeated(plane: Float) -> Color:
    return np.repeat(plane[..., None], 3, axis=2).astype(np.float32)


def checkerboard() -> Float:
    return (np.indices((32, 32)).sum(axis=0) % 2).astype(np.float64)


def step() -> Float:
    return np.tile(np.where(np.arange(32) < 16, 0.0, 1.0), (32, 1))


RAMP = np.tile(np.linspace(0, 1, 32), (32, 1))


def test_flat_images_leave_the_brightness_term_alone() -> None:
    """(2 * .5 * .6 + C1) / (.5^2 + .6^2 + C1) = .6001 / .6101 where the window lies in the image."""
    values = ssim_map(flat(0.5, 20, 24), flat(0.6, 20, 24))
    assert values.shape == (10, 14, 3)
    assert values == pytest.approx(0.6001 / 0.6101, abs=1e-5)


@pytest.mark.parametrize(
    ("image", "reference", "valid", "padded"),
    [
        (flat(0.5, 16, 16), flat(0.6, 16, 16), 0.98360924, 0.97120429),
        (flat(0.5, 32, 32), flat(0.6, 32, 32), 0.98360924, 0.97626310),
        (repeated(checkerboard()), repeated(1 - checkerboard()), -0.99640647, -0.88681230),
        (repeated(step()), flat(0.5, 32, 32), 0.24073924, 0.27403648),
        (repeated(RAMP), repeated(0.9 * RAMP), 0.98994800, 0.98978708),
    ],
)
def test_windows_inside_and_beyond_the_image(image: Color, reference: Color, valid: float, padded: float) -> None:
    """Known values of both, computed in float64 elsewhere."""
    assert ssim_map(image, reference).mean() == pytest.approx(valid, abs=1e-5)
    assert padded_ssim_map(image, reference).shape == image.shape
    assert ssim_3dgs(image, reference) == pytest.approx(padded, abs=1e-5)


def test_every_pixel_is_scikit_images() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((40, 50, 3), dtype=np.float32)
    reference = np.clip(image + rng.normal(0, 0.1, image.shape), 0, 1).astype(np.float32)
    _, expected = structural_similarity(
        image.astype(np.float64),
        reference.astype(np.float64),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
        full=True,
    )
    assert ssim_map(image, reference) == pytest.approx(expected[5:-5, 5:-5], abs=2e-5)


@pytest.mark.parametrize(
    ("height", "width", "expected"),
    [(176, 176, 0.9977994), (161, 161, 0.9962487), (370, 1226, 0.9976937), (376, 1241, 0.9977570)],
)
def test_ms_ssim_of_flat_images_is_pytorch_msssims(height: int, width: int, expected: float) -> None:
    """176: no odd side, (.6001 / .6101)^.1333; the others show the zeros before odd sides (that package's output)."""
    assert ms_ssim(flat(0.5, height, width), flat(0.6, height, width)) == pytest.approx(expected, abs=5e-6)


def blurred(values: Float) -> Float:
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    for axis in (0, 1):
        values = correlate1d(values, taps / taps.sum(), axis=axis)
    return values[5:-5, 5:-5]


def halved(values: Float) -> Float:
    height, width, channels = values.shape
    padded = np.zeros((height + 2 * (height % 2), width + 2 * (width % 2), channels))
    padded[height % 2 : height % 2 + height, width % 2 : width % 2 + width] = values
    rows, columns = padded.shape[0] // 2, padded.shape[1] // 2
    return padded[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, channels).mean(axis=(1, 3))


def test_ms_ssim_of_noise_is_the_formula_in_float64() -> None:
    rng = np.random.default_rng(1)
    reference = blurred(rng.random((193, 179, 3))) * np.array([0.9, 0.5, 0.2])
    image = np.clip(reference + rng.normal(0, 0.02, reference.shape), 0, 1)
    x, y = image.astype(np.float32).astype(np.float64), reference.astype(np.float32).astype(np.float64)
    product = np.ones(3)
    for scale, weight in enumerate((0.0448, 0.2856, 0.3001, 0.2363, 0.1333)):
        x, y = (halved(x), halved(y)) if scale else (x, y)
        mean_x, mean_y = blurred(x), blurred(y)
        variance_x, variance_y = blurred(x * x) - mean_x**2, blurred(y * y) - mean_y**2
        part = (2 * (blurred(x * y) - mean_x * mean_y) + 9e-4) / (variance_x + variance_y + 9e-4)
        if scale == 4:
            part = part * (2 * mean_x * mean_y + 1e-4) / (mean_x**2 + mean_y**2 + 1e-4)
        product *= part.mean(axis=(0, 1)) ** weight
    assert 0.5 < product.mean() < 0.995
    assert ms_ssim(image.astype(np.float32), reference.astype(np.float32)) == pytest.approx(product.mean(), abs=2e-6)


def test_opposite_images_have_no_ms_ssim_left() -> None:
    """The covariance is negative at the first scale, and counts as 0."""
    board = repeated(np.indices((176, 176)).sum(axis=0) % 2)
    assert ms_ssim(board, 1 - board) == 0.0


def test_too_small_images_are_named() -> None:
    with pytest.raises(BenchError, match=r"MS-SSIM needs images of at least 161 pixels on a side; these are 300x160\."):
        ms_ssim(flat(0.5, 160, 300), flat(0.5, 160, 300))
    with pytest.raises(BenchError, match=r"at least 11x11 pixels; these are 10x40 and 10x40"):
        ssim_map(flat(0.5, 40, 10), flat(0.5, 40, 10))
