"""EPE, D1, bad-n, density and the filling of holes, on cases worked by hand and against a plain loop."""

from __future__ import annotations

import numpy as np
import pytest

from bench.errors import BenchError
from bench.evaluation.disparity import (
    DisparityScore,
    background_interpolated,
    disparity_of_depth,
    score_disparity,
    visible_returns,
)
from bench.types import StereoCamera

NAN = np.nan


def rows(*values: list[float]) -> np.ndarray:
    return np.array(values, np.float32)


def test_one_image_by_hand() -> None:
    """Errors 3.5, 2.9, 4 and 8 px; only the first is above 5 % of its truth as well: the others are 5.8, 4 and 4 %."""
    score = score_disparity(rows([13.5, 52.9, 104, 208]), rows([10, 50, 100, 200]))
    for errors in (score.filled, score.interpolated):
        assert errors.pixels == 4
        assert errors.epe_px == pytest.approx(4.6, abs=1e-6)
        assert errors.bad_percent == (100.0, 100.0, 75.0)
        assert errors.d1_percent == 25.0
    assert (score.density_percent, score.holes_percent) == (100.0, 0.0)


def test_both_limits_of_d1_are_strict() -> None:
    """Exactly 3 px is no outlier; 3.5 px of 70 px is exactly 5 % and none either; a sixteenth of a pixel more is."""
    assert score_disparity(rows([13, 73.5]), rows([10, 70])).filled.d1 == 0
    assert score_disparity(rows([13, 73.5]), rows([10, 70])).filled.bad == (2, 2, 1)
    assert score_disparity(rows([13.0625, 73.5625]), rows([10, 70])).filled.d1 == 2


def test_holes_count_where_they_are_filled_and_only_there() -> None:
    """The hole lies between 10 and 30 and gets the background, 10: an error of 15 px against its truth of 25."""
    score = score_disparity(rows([10, NAN, 30, NAN]), rows([11, 25, 30, NAN]))
    assert (score.filled.pixels, score.filled.epe_px) == (2, 0.5)
    assert (score.interpolated.pixels, score.interpolated.epe_px) == (3, pytest.approx(16 / 3))
    assert (score.filled.d1_percent, score.interpolated.d1_percent) == (0.0, pytest.approx(100 / 3))
    assert score.density_percent == pytest.approx(200 / 3)
    assert score.holes_percent == 50.0


def test_pooling_weighs_pixels_and_not_images() -> None:
    """One pixel wrong of one, none wrong of three: 25 % of the pixels, though 50 % on the mean of the images."""
    first = score_disparity(rows([20, NAN, NAN]), rows([10, NAN, NAN]))
    second = score_disparity(rows([10, 20, 30]), rows([10, 20, 30]))
    pooled = sum([first, second], DisparityScore())
    assert (pooled.filled.d1_percent, pooled.filled.epe_px) == (25.0, 2.5)
    assert (first.filled.d1_percent, second.filled.d1_percent) == (100.0, 0.0)
    assert pooled.holes_percent == pytest.approx(100 * 2 / 6)


def test_an_image_without_any_estimate_is_wrong_everywhere() -> None:
    score = score_disparity(rows([NAN, NAN]), rows([10, 50]))
    assert (score.filled.epe_px, score.filled.d1_percent, score.filled.bad_percent) == (None, None, (None, None, None))
    assert (score.interpolated.epe_px, score.interpolated.d1_percent) == (30.0, 100.0)
    assert (score.density_percent, score.holes_percent) == (0.0, 100.0)
    assert score_disparity(rows([10]), rows([NAN])).density_percent is None


def test_filling_by_hand() -> None:
    holes = rows(
        [NAN, NAN, NAN, NAN],
        [NAN, 8, NAN, 5],
        [NAN, NAN, NAN, NAN],
        [3, NAN, NAN, 9],
        [NAN, NAN, NAN, NAN],
    )
    filled = rows(
        [8, 8, 5, 5],
        [8, 8, 5, 5],
        [3, 3, 3, 5],
        [3, 3, 3, 9],
        [3, 3, 3, 9],
    )
    assert np.array_equal(background_interpolated(holes), filled)
    assert np.array_equal(background_interpolated(filled), filled)
    assert np.isnan(background_interpolated(rows([NAN, NAN]))).all()


def plainly_filled(line: list[float]) -> list[float]:
    """A line with each hole replaced by the smaller of its neighbours that are known."""
    out = list(line)
    for i, value in enumerate(line):
        if np.isnan(value):
            left = next((line[j] for j in range(i - 1, -1, -1) if not np.isnan(line[j])), np.inf)
            right = next((line[j] for j in range(i + 1, len(line)) if not np.isnan(line[j])), np.inf)
            out[i] = min(left, right) if min(left, right) < np.inf else NAN
    return out


def test_filling_against_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    for share in (0.2, 0.9, 0.97):
        values = rng.uniform(1, 60, (17, 23)).astype(np.float32)
        values[rng.random(values.shape) < share] = NAN
        along = np.array([plainly_filled(list(line)) for line in values])
        plain = np.array([plainly_filled(list(column)) for column in along.T]).T
        assert np.array_equal(background_interpolated(values), plain.astype(np.float32))


def test_returns_behind_a_nearer_one_are_dropped() -> None:
    """10 m is 20 % nearer than 12.5 and within 3 pixels of it; 11.5 is less than 10 % behind 10.5; 4 pixels are far."""
    lidar = np.full((7, 12), NAN, np.float32)
    lidar[3, 0], lidar[0, 3] = 10.0, 12.5
    lidar[6, 11], lidar[6, 8] = 11.5, 10.5
    lidar[2, 7] = 30.0
    expected = lidar.copy()
    expected[0, 3] = NAN
    assert np.array_equal(visible_returns(lidar), expected, equal_nan=True)


def test_disparity_of_depth() -> None:
    camera = StereoCamera(3, 1, 700.0, 700.0, 1.0, 0.0, (0.5, 0.0, 0.0))
    disparity = disparity_of_depth(rows([10, NAN, 70]), camera)
    assert disparity.dtype == np.float32
    np.testing.assert_allclose(disparity, rows([35, NAN, 5]), rtol=1e-6)


def test_maps_of_different_size_are_refused() -> None:
    with pytest.raises(BenchError, match="disparity is 2x1 and its truth 3x1; they must be of the same size"):
        score_disparity(rows([1, 2]), rows([1, 2, 3]))
