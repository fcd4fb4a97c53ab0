"""Feed a matcher a smaller or larger pair and bring its disparity back to the pair's own size and pixels."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from bench.contracts.stereo import Matched
from bench.types import Image, Map

Matcher = Callable[[Image, Image], Matched]
"""A rectified pair (H, W, 3) to the left image's disparity (H, W) in pixels of the images that it is given."""


def at_scale(matcher: Matcher, left: Image, right: Image, scale: float) -> Matched:
    """Disparity (H, W) in pixels of the given pair, from a matcher that sees the pair ``scale`` times as large.

    Both sides are rounded to whole pixels, and the disparity is multiplied by the exact ratio of the widths.
    """
    height, width = left.shape[:2]
    fed = (max(1, round(height * scale)), max(1, round(width * scale)))
    disparity, confidence = matcher(resize_image(left, fed), resize_image(right, fed))
    return resize_matched(disparity, confidence, (height, width))


def resize_matched(disparity: Map, confidence: Map | None, shape: tuple[int, int]) -> Matched:
    """Both at ``shape`` = (height, width): the disparity as by ``resize_disparity``, the confidence bilinear."""
    if confidence is not None:
        confidence = np.clip(_bilinear(confidence, shape), np.float32(0), np.float32(1))
    return Matched(resize_disparity(disparity, shape), confidence)


def resize_image(image: Image, shape: tuple[int, int]) -> Image:
    """The image at ``shape`` = (height, width): area means where it shrinks, bilinear where it grows."""
    if image.shape[:2] == shape:
        return image
    shrinks = shape[0] <= image.shape[0] and shape[1] <= image.shape[1]
    return np.asarray(
        cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.uint8
    )


def resize_disparity(disparity: Map, shape: tuple[int, int]) -> Map:
    """A disparity map (h, w) at ``shape`` = (H, W), in pixels of that size: bilinear, values times W / w.

    Next to unknown pixels the known ones are interpolated among themselves; a pixel is unknown where more than half of
    its weight is.
    """
    ratio = np.float32(shape[1] / disparity.shape[1])
    known = np.isfinite(disparity)
    if known.all():
        return _bilinear(disparity, shape) * ratio
    weight = _bilinear(known.astype(np.float32), shape)
    total = _bilinear(np.where(known, disparity, np.float32(0)), shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weight >= 0.5, total / weight * ratio, np.float32(np.nan))


def _bilinear(values: Map, shape: tuple[int, int]) -> Map:
    return np.asarray(cv2.resize(values, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
