"""Matching in boxes against brute force, and the choice worked by hand."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from bench.tracking.features import Features
from bench.tracking.matching import expand_ranges, match_boxes, one_to_one
from bench.tracking.relocalise import match_descriptors, pose_by_pnp
from bench.types import StereoCamera


def random_features(rng: np.random.Generator, count: int) -> Features:
    bits = rng.integers(0, 256, (count, 32), dtype=np.uint8).view(np.uint64)
    return Features(rng.uniform(0, 300, (count, 2)), rng.integers(0, 8, count), bits)


@pytest.mark.parametrize("ratio", [1.0, 0.9])
@pytest.mark.parametrize("real", [False, True])
def test_boxes_give_what_brute_force_gives(ratio: float, real: bool) -> None:
    rng = np.random.default_rng(0)
    features = random_features(rng, 500)
    if real:
        features = replace(features, descriptors=rng.integers(-40, 41, (500, 64), dtype=np.int8))
    uv, radius, octave = rng.uniform(-20, 320, (150, 2)), rng.uniform(5, 60, 150), rng.uniform(-1, 8, 150)
    descriptor = features.descriptors[rng.permutation(500)[:150]]
    disparity, seen = rng.uniform(0, 80, 150), np.where(rng.random(500) < 0.5, np.nan, rng.uniform(0, 80, 500))
    if real:
        apart = np.linalg.norm(descriptor[:, None].astype(np.float64) - features.descriptors, axis=2)
    else:
        apart = np.unpackbits((descriptor[:, None] ^ features.descriptors[None]).view(np.uint8), axis=2).sum(2)
    most = 260 if real else 120
    wanted: dict[int, list[tuple[float, int]]] = {}
    for q in range(150):
        inside = (np.abs(features.xy - uv[q]) <= radius[q]).all(1) & (np.abs(features.octave - octave[q]) <= 1.5)
        inside &= np.isnan(seen) | (np.abs(seen - disparity[q]) <= radius[q])
        near = sorted((float(apart[q, j]), int(j)) for j in np.flatnonzero(inside))
        if near and near[0][0] <= most and (ratio == 1.0 or len(near) < 2 or near[0][0] < ratio * near[1][0]):
            wanted.setdefault(near[0][1], []).append((near[0][0], q))
    expected = sorted((min(rivals)[1], keypoint) for keypoint, rivals in wanted.items())
    found = match_boxes(uv, radius, octave, disparity, descriptor, features, seen, most, ratio)
    assert list(zip(*(x.tolist() for x in found), strict=True)) == expected
    assert len(expected) > 10


def test_boxes_without_keypoints_or_queries() -> None:
    rng = np.random.default_rng(0)
    one, none = np.ones(1), np.empty(0)
    empty = random_features(rng, 0)
    bits = np.zeros((1, 4), np.uint64)
    assert len(match_boxes(np.zeros((1, 2)), one, one, one, bits, empty, none, 80, 1.0)[0]) == 0
    some = random_features(rng, 5)
    assert len(match_boxes(np.zeros((0, 2)), none, none, none, bits[:0], some, np.ones(5), 80, 1.0)[0]) == 0


def test_rivals_worked_by_hand() -> None:
    # Queries 0, 2 and 3 want keypoint 5; 2 and 3 are nearer than 0, and 2 comes first. Query 1 wants nothing.
    found = one_to_one(np.array([5, -1, 5, 5, 7]), np.array([9, 0, 4, 4, 30]))
    assert found.tolist() == [2, 4]


def test_ranges_worked_by_hand() -> None:
    owner, place = expand_ranges(np.array([3, 7, 1]), np.array([5, 7, 2]))
    assert owner.tolist() == [0, 0, 2]
    assert place.tolist() == [3, 4, 1]


@pytest.mark.parametrize("seed", [1, 2])
def test_pnp_does_not_depend_on_opencv_s_global_seed(seed: int) -> None:
    rng = np.random.default_rng(0)
    camera = StereoCamera(1226, 370, 707.0, 707.0, 601.0, 183.0, (0.54, 0.0, 0.0))
    points = np.column_stack([rng.uniform(-8, 8, 80), rng.uniform(-3, 2, 80), rng.uniform(10, 40, 80)])
    moved = points - (0.5, 0.1, 2.0)
    uv = moved[:, :2] / moved[:, 2:] * 707.0 + (601.0, 183.0)
    uv[:40] = rng.uniform(0, 370, (40, 2))
    cv2.setRNGSeed(seed)
    T = pose_by_pnp(camera, points, uv)
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], (-0.5, -0.1, -2.0), atol=1e-3)
    cv2.setRNGSeed(99)
    np.testing.assert_array_equal(T, pose_by_pnp(camera, points, uv))


def test_descriptors_match_as_opencv_matches_them() -> None:
    """Oracle: OpenCV's brute-force matcher with cross check, and its two nearest neighbours for the ratio."""
    rng = np.random.default_rng(0)
    a = rng.integers(0, 256, (200, 32), dtype=np.uint8)
    b = a[rng.permutation(200)[:150]].copy()
    b ^= np.packbits(rng.random((150, 256)) < 0.12, axis=1)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    mutual = {(m.queryIdx, m.trainIdx) for m in cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(a, b)}
    clear = {
        (m.queryIdx, m.trainIdx) for m, n in matcher.knnMatch(a, b, k=2) if m.distance < min(0.8 * n.distance, 60.5)
    }
    found = match_descriptors(a.view(np.uint64), b.view(np.uint64), ratio=0.8)
    assert set(zip(*(x.tolist() for x in found), strict=True)) == mutual & clear
    assert len(found[0]) > 100
