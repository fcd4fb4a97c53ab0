"""ORB features against OpenCV's FAST and ORB, buckets worked by hand, and the place of keypoints in the octaves."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench import _native
from bench.io.images import grey
from bench.tracking.features import OrbExtractor
from bench.tracking.orb_tests import comparisons


def textured(height: int = 360, width: int = 720, blur: float = 3.0) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(height, width)), (0, 0), blur)
    return np.clip(128 + 50 * noise / noise.std(), 0, 255).astype(np.uint8)


def test_buckets_give_their_best_before_any_second_best() -> None:
    # Two buckets of 30 px: three strong corners in the left one, one weak corner in the right one.
    corners = np.array([[1, 1, 100], [5, 5, 250], [9, 9, 200], [40, 5, 10]])
    assert sorted(x for x, _, _ in _native.bucketed(corners, 2, 30)) == [5, 40]
    assert sorted(x for x, _, _ in _native.bucketed(corners, 3, 30)) == [5, 9, 40]
    assert sorted(x for x, _, _ in _native.bucketed(corners, 9, 30)) == [1, 5, 9, 40]
    assert _native.bucketed(corners, 0, 30) == ()
    assert _native.bucketed(corners[:0], 5, 30) == ()


def test_keypoints_are_fast_corners() -> None:
    """Every keypoint of octave 0 is a corner by OpenCV's FAST, at most half a pixel off; with room for all of them,
    nearly all of OpenCV's own local maxima are found (ties between neighbours are broken otherwise)."""
    image = textured()
    features, _ = OrbExtractor(20000, octaves=1, fast_threshold=20).extract(image)
    ours = set(map(tuple, np.rint(features.xy).astype(int).tolist()))
    every = cv2.FastFeatureDetector.create(20, nonmaxSuppression=False).detect(image)
    corners = {(int(k.pt[0]), int(k.pt[1])) for k in every}
    assert np.mean([xy in corners for xy in ours]) > 0.97
    best = cv2.FastFeatureDetector.create(20, nonmaxSuppression=True).detect(image)
    inside = [k.pt for k in best if 20 < k.pt[0] < 699 and 20 < k.pt[1] < 339]
    near = [np.abs(features.xy - corner).sum(1).min() <= 1.0 for corner in inside]
    assert len(inside) > 300
    assert np.mean(near) > 0.95


def test_descriptors_are_those_of_opencv() -> None:
    """Same keypoints given to cv2.ORB, with the centroid's angle in numpy: only roundings of the blur may differ."""
    image = textured(blur=1.5)
    features, _ = OrbExtractor(600, octaves=1).extract(image)
    v, u = np.mgrid[-15:16, -15:16]
    half = np.array([15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3])
    disc = np.abs(u) <= half[np.abs(v)]
    keypoints = []
    for i, (x, y) in enumerate(np.rint(features.xy).astype(int)):
        # Half a pixel off, rounding may choose the pixel beside the corner.
        if 32 <= x < 688 and 32 <= y < 328 and np.abs(features.xy[i] - (x, y)).max() < 0.49:
            patch = image[y - 15 : y + 16, x - 15 : x + 16] * disc
            angle = np.degrees(np.arctan2((v * patch).sum(), (u * patch).sum())) % 360
            keypoints.append(cv2.KeyPoint(float(x), float(y), 31.0, float(angle), 1.0, 0, i))
    kept, expected = cv2.ORB.create(nlevels=1).compute(image, keypoints)
    ours = features.descriptors[[k.class_id for k in kept]]
    bits = np.bitwise_count(ours.view(np.uint8) ^ expected).sum(1)
    assert len(bits) > 300
    assert bits.mean() < 2.0
    assert bits.max() <= 20


def test_comparisons_stay_inside_the_patch() -> None:
    tests = comparisons()
    assert tests.shape == (4, 256)
    assert np.abs(tests).max() <= 13
    assert len(np.unique(tests.T, axis=0)) == 256


def test_pyramid_is_a_bilinear_one() -> None:
    image = textured()
    _, pyramid = OrbExtractor(500).extract(image)
    for above, level in zip(pyramid.levels, pyramid.levels[1:], strict=False):
        expected = cv2.resize(above, level.shape[::-1], interpolation=cv2.INTER_LINEAR_EXACT)
        difference = np.abs(level.astype(int) - expected)
        assert difference.max() <= 2
        assert difference.mean() < 0.3


def test_tiny_images_have_no_features() -> None:
    for shape in ((1, 1), (8, 300), (40, 40)):
        features, _ = OrbExtractor(500).extract(np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8))
        assert len(features) == 0


def test_views_into_larger_images_work() -> None:
    whole = textured()
    window = whole[20:300, 40:640]
    a, b = OrbExtractor(300).extract(window)[0], OrbExtractor(300).extract(window.copy())[0]
    np.testing.assert_array_equal(a.xy, b.xy)
    np.testing.assert_array_equal(a.descriptors, b.descriptors)


@pytest.mark.parametrize("octave", [0, 3, 5, 7])
def test_keypoints_have_no_bias_in_any_octave(octave: int) -> None:
    """In the image turned upside down each corner is at the mirrored place; a bias b would show as 2 b.

    OpenCV's own coordinates have b = (scale - 1) / 2: 1.3 pixels in octave 7.
    """
    image = textured()
    upright, turned = (OrbExtractor(1500).extract(x)[0] for x in (image, np.ascontiguousarray(image[::-1, ::-1])))
    xy, mirrored = upright.xy[upright.octave == octave], (719, 359) - turned.xy[turned.octave == octave]
    difference = xy[:, None] - mirrored[None]
    nearest = np.abs(difference).sum(2).argmin(1)
    offsets = difference[np.arange(len(xy)), nearest]
    assert len(offsets) > 40
    np.testing.assert_allclose(np.median(offsets, axis=0), 0.0, atol=0.15)


def test_blank_images_have_no_features() -> None:
    features, pyramid = OrbExtractor(500).extract(np.zeros((240, 320), np.uint8))
    assert len(features) == 0
    assert features.descriptors.shape == (0, 4)
    assert len(pyramid.levels) == 8


def test_grey_of_a_grey_picture_in_rgb_is_unchanged() -> None:
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_array_equal(grey(np.dstack([image] * 3)), image)
