"""Candidate search against brute force, Hamming distance against OpenCV, and the choice worked by hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench.tracking.matching import KeypointIndex, choose_one_to_one, hamming
from bench.tracking.relocalise import match_descriptors, pose_by_pnp
from bench.types import StereoCamera


def test_boxes_find_what_brute_force_finds() -> None:
    rng = np.random.default_rng(0)
    xy, centre = rng.uniform(0, 300, (400, 2)), rng.uniform(-20, 320, (150, 2))
    half = rng.uniform(0, 40, (150, 2))
    low, high = centre - half, centre + half
    query, keypoint = KeypointIndex(xy).pairs(low[:, 0], high[:, 0], low[:, 1], high[:, 1])
    inside = ((xy >= low[:, None]) & (xy <= high[:, None])).all(2)
    assert sorted(zip(query, keypoint, strict=True)) == sorted(zip(*np.nonzero(inside), strict=True))


def test_boxes_without_keypoints() -> None:
    one = np.ones(1)
    assert len(KeypointIndex(np.empty((0, 2))).pairs(0 * one, one, 0 * one, one)[0]) == 0


def test_hamming_equals_opencv() -> None:
    a, b = np.random.default_rng(0).integers(0, 256, (2, 32), dtype=np.uint8)
    assert hamming(a.view(np.uint64), b.view(np.uint64)) == cv2.norm(a, b, cv2.NORM_HAMMING)


def test_choice_worked_by_hand() -> None:
    # Query 0: keypoint 5 at 10, 6 at 30. Query 1: 5 at 8, 7 at 9 (fails the ratio). Query 2: 5 at 7. Query 3: 8 at 99.
    query, keypoint = np.array([0, 0, 1, 1, 2, 3]), np.array([5, 6, 5, 7, 5, 8])
    distance = np.array([10, 30, 8, 9, 7, 99])
    found = choose_one_to_one(query, keypoint, distance, max_distance=50, ratio=0.8)
    assert [x.tolist() for x in found] == [[2], [5], [7]]
    found = choose_one_to_one(query, keypoint, distance, max_distance=100)
    assert [x.tolist() for x in found] == [[2, 3], [5, 8], [7, 99]]


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
