"""Buckets worked by hand, and the place of keypoints in the higher octaves."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench.tracking.features import OrbExtractor, bucketed, grey


def test_buckets_give_their_best_before_any_second_best() -> None:
    # Two buckets of 30 px: three strong corners in the left one, one weak corner in the right one.
    xy = np.array([[1.0, 1.0], [5.0, 5.0], [9.0, 9.0], [40.0, 5.0]])
    response = np.array([100.0, 300.0, 200.0, 1.0])
    octave = np.zeros(4, dtype=np.int64)
    assert sorted(bucketed(xy, response, octave, 1.2, np.array([2]))) == [1, 3]
    assert sorted(bucketed(xy, response, octave, 1.2, np.array([3]))) == [1, 2, 3]
    assert sorted(bucketed(xy, response, octave, 1.2, np.array([9]))) == [0, 1, 2, 3]


def test_octaves_are_filled_apart() -> None:
    xy, response = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]), np.array([9.0, 8.0, 7.0])
    assert sorted(bucketed(xy, response, np.array([0, 1, 1]), 1.2, np.array([5, 1]))) == [0, 1]


@pytest.mark.parametrize("octave", [0, 3, 5, 7])
def test_keypoints_have_no_bias_in_any_octave(octave: int) -> None:
    """In the image turned upside down each corner is at the mirrored place; a bias b would show as 2 b.

    OpenCV's own coordinates have b = (scale - 1) / 2: 1.3 pixels in octave 7.
    """
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(360, 720)), (0, 0), 3.0)
    image = np.clip(128 + 50 * noise / noise.std(), 0, 255).astype(np.uint8)
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
