"""Which parts of a sky mask stereo removes, on a picture of three parts."""

from __future__ import annotations

import numpy as np
import pytest

from bench.errors import BenchError
from bench.sky.near import NearLimit

NAN = np.float32(np.nan)


def three_parts() -> np.ndarray:
    """Sky in columns 0 to 39, a wall in 41 to 59, another in 61 to 79; everything from row 30 on is ground."""
    mask = np.zeros((50, 80), dtype=bool)
    mask[:30] = True
    mask[:, [40, 60]] = False
    return mask


def depth_with(sky: float, near_share_of_sky: float, wall: float, other: float) -> np.ndarray:
    depth = np.full((50, 80), NAN, dtype=np.float32)
    depth[:30, :40] = sky
    depth[:30, : round(40 * near_share_of_sky)] = 10.0
    depth[:30, 41:60] = wall
    depth[:30, 61:] = other
    return depth


def test_a_near_wall_goes_and_a_far_one_stays() -> None:
    left = NearLimit(30.0, 0.85).applied(three_parts(), depth_with(200.0, 0.0, 12.0, 31.0))
    assert left[:30, :40].all()
    assert not left[:, 41:60].any()
    assert left[:30, 61:].all()
    assert not left[30:].any()


@pytest.mark.parametrize(("share", "stays"), [(0.8, True), (0.9, False)])
def test_a_part_is_judged_by_its_share_of_near_pixels(share: float, stays: bool) -> None:
    left = NearLimit(30.0, 0.85).applied(three_parts(), depth_with(200.0, share, NAN, NAN))
    assert left[:30, :40].all() == stays
    assert left[:30, :40].any() == stays


def test_what_is_unknown_says_nothing() -> None:
    depth = np.full((50, 80), NAN, dtype=np.float32)
    # Below 5 % of the wall's 570 pixels: too little to judge by.
    depth[0, 41:59] = 5.0
    assert np.array_equal(NearLimit(30.0, 0.85).applied(three_parts(), depth), three_parts())
    depth[:2, 41:60] = 5.0
    assert not NearLimit(30.0, 0.85).applied(three_parts(), depth)[:, 41:60].any()


def test_zero_metres_removes_nothing_and_no_sky_is_no_sky() -> None:
    depth = np.full((50, 80), 1.0, dtype=np.float32)
    assert np.array_equal(NearLimit(0.0, 0.85).applied(three_parts(), depth), three_parts())
    assert not NearLimit(30.0, 0.85).applied(np.zeros((50, 80), dtype=bool), depth).any()


def test_wrong_settings() -> None:
    with pytest.raises(BenchError, match=r"sky.min_depth_m=-1 is negative; give metres"):
        NearLimit(-1, 0.85)
    with pytest.raises(BenchError, match=r"sky.max_near=1.0 is no share between 0 and 1, for example 0.8"):
        NearLimit(30, 1.0)
