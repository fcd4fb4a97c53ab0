"""Depth-L1 on cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from bench.errors import BenchError
from bench.evaluation.depth import depth_l1_cm

NAN = np.nan


def row(*values: float) -> np.ndarray:
    return np.array([values], np.float32)


def test_only_pixels_with_a_return_count() -> None:
    rendered, lidar = row(5, 12, 18, 7), row(NAN, 10, 20, NAN)
    assert depth_l1_cm(rendered, lidar, 0.5, None) == (pytest.approx(200.0), 2)


def test_a_hole_in_the_render_is_an_error_of_the_full_depth() -> None:
    """(0.5 + 2 + 40 + 5) / 4 = 11.875 m, whether the hole is 0 or NaN; dropping it would give 14.17 m."""
    lidar = row(2, NAN, 10, 50, 5)
    for hole in (0.0, NAN):
        error, n = depth_l1_cm(row(2.5, 3, 8, 90, hole), lidar, 0.5, None)
        assert (error, n) == (pytest.approx(1187.5), 4)


def test_the_range_limits_returns_and_not_renders() -> None:
    rendered, lidar = row(1, 200, 50), row(0.4, 70, 85)
    assert depth_l1_cm(rendered, lidar, 0.5, None) == (pytest.approx(100 * (130 + 35) / 2), 2)
    assert depth_l1_cm(rendered, lidar, 0.5, 80.0) == (pytest.approx(13000.0), 1)


def test_no_return_gives_nan_and_zero() -> None:
    error, n = depth_l1_cm(row(1, 2), row(NAN, NAN), 0.5, None)
    assert np.isnan(error)
    assert n == 0


def test_maps_of_different_size_are_refused() -> None:
    with pytest.raises(BenchError, match="rendered depth is 2x1 and the LiDAR depth 3x1"):
        depth_l1_cm(row(1, 2), row(1, 2, 3), 0.5, None)
