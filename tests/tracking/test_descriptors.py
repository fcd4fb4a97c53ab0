"""Distances and middles of both kinds of descriptors, against OpenCV, float64 and counting."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench import _native
from bench.tracking.descriptors import are_descriptors, as_they_were, metric_of, whole_numbers
from bench.tracking.relocalise import match_descriptors

RNG = np.random.default_rng(0)
BITS = RNG.integers(0, 256, (9, 32), dtype=np.uint8).view(np.uint64)
REAL = RNG.integers(-127, 128, (9, 64), dtype=np.int8)


def test_distances_equal_opencv() -> None:
    by_hand = [[cv2.norm(a.view(np.uint8), b.view(np.uint8), cv2.NORM_HAMMING) for b in BITS[4:]] for a in BITS[:4]]
    assert metric_of(BITS).rank(BITS[:4, None], BITS[4:]).tolist() == by_hand
    by_hand = [[cv2.norm(a.astype(np.float64), b.astype(np.float64)) for b in REAL[4:]] for a in REAL[:4]]
    np.testing.assert_allclose(metric_of(REAL).rank(REAL[:4, None], REAL[4:]) ** 0.5, by_hand, rtol=1e-12)


@pytest.mark.parametrize("real", [False, True])
def test_middles_are_rounded_means_also_of_more_than_255(real: bool) -> None:
    group = RNG.choice(3, 2001, p=[0.8, 0.19, 0.01])
    values = RNG.integers(-90, 120, (2001, 64)) if real else (RNG.random((2001, 256)) < 0.6).astype(np.int64)
    expected = [np.rint(values[group == g].mean(axis=0)) for g in range(3)]
    if real:
        given = values.astype(np.int8)
        assert np.array_equal(metric_of(given).middles(given, group, 3), expected)
    else:
        given = np.packbits(values.astype(bool), axis=1).view(np.uint64)
        expected = [values[group == g].mean(axis=0) > 0.5 for g in range(3)]
        middles = metric_of(given).middles(given, group, 3)
        assert np.array_equal(np.unpackbits(middles.view(np.uint8), axis=1), expected)


def test_real_descriptors_match_as_opencv_matches_them() -> None:
    """Oracle: OpenCV's brute-force matcher in float32, on the vectors before they were made whole numbers."""
    a = RNG.standard_normal((200, 64)).astype(np.float32)
    b = a[RNG.permutation(200)[:150]] + 0.3 * RNG.standard_normal((150, 64)).astype(np.float32)
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (a, b))
    mutual = {(m.queryIdx, m.trainIdx) for m in cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(a, b)}
    near = {(m.queryIdx, m.trainIdx) for m, n in cv2.BFMatcher().knnMatch(a, b, k=2) if m.distance < 0.7 * n.distance}
    found = match_descriptors(whole_numbers(a), whole_numbers(b), ratio=0.7)
    assert set(zip(*(x.tolist() for x in found), strict=True)) == mutual & near
    assert len(found[0]) > 100


def test_rows_are_paired_by_the_length_of_the_difference() -> None:
    n = 200
    left = RNG.integers(-20, 21, (n, 64), dtype=np.int8)
    right = np.clip(left[::-1] + RNG.integers(-6, 7, (n, 64)), -127, 127).astype(np.int8)
    xy_left, xy_right = RNG.uniform(0, 100, (2, n, 2))
    octave, band = np.zeros(n, np.int64), np.full(n, 30.0)
    best, squared = _native.pair_rows(xy_left, octave, left, xy_right, octave, right, band, 50.0, 1.0, 90)
    apart = np.linalg.norm(left[:, None].astype(np.float64) - right, axis=2)
    shift = xy_left[:, None, 0] - xy_right[:, 0]
    allowed = (np.abs(xy_left[:, None, 1] - xy_right[:, 1]) <= 30) & (shift <= 50) & (shift >= -1) & (apart <= 90)
    apart[~allowed] = np.inf
    expected = np.where(allowed.any(axis=1), apart.argmin(axis=1), -1)
    assert best.tolist() == expected.tolist()
    assert (expected >= 0).sum() > 10
    np.testing.assert_allclose(squared[expected >= 0] ** 0.5, apart.min(axis=1)[expected >= 0])


def test_kinds_do_not_mix() -> None:
    xy, octave, none = np.zeros((9, 2)), np.zeros(9, np.int64), np.full(9, np.nan)
    with pytest.raises(ValueError, match="descriptors of one kind"):
        _native.pair_rows(xy, octave, BITS, xy, octave, REAL, np.ones(9), 9.0, 1.0, 75)
    with pytest.raises(ValueError, match="descriptors of one kind"):
        _native.match_boxes(xy, none, none, none, BITS, xy, octave, none, REAL, 80, 1.0, 1.5)
    with pytest.raises(ValueError, match=r"\(N, 4\) uint64 or \(N, 64\) int8"):
        _native.pair_rows(xy, octave, REAL[:, :32].copy(), xy, octave, REAL, np.ones(9), 9.0, 1.0, 75)
    assert are_descriptors(BITS)
    assert are_descriptors(REAL)
    assert not are_descriptors(BITS.view(np.int64))
    assert np.array_equal(as_they_were(BITS.view(np.int64)), BITS)
    assert as_they_were(REAL) is REAL
