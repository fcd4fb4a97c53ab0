"""The left-right check: a disparity counts where the right image's own disparity leads back."""

from __future__ import annotations

import cv2
import numpy as np

from bench.stereo.resizing import Matcher
from bench.types import Image, Map, Mask


def left_right_checked(matcher: Matcher, left: Image, right: Image, max_px: float) -> Map:
    """Disparity (H, W), NaN where the right image's differs by more than ``max_px``: occlusions and wrong matches.

    Costs a second match: the right image's disparities are those of the mirrored pair with its sides exchanged.
    """
    disparity = matcher(left, right)
    of_right = matcher(mirrored(right), mirrored(left))[:, ::-1]
    return np.where(consistent(disparity, of_right, max_px), disparity, np.float32(np.nan))


def mirrored(image: Image) -> Image:
    """The image with its columns in reverse order."""
    return np.ascontiguousarray(image[:, ::-1])


def consistent(left: Map, right: Map, max_px: float) -> Mask:
    """Where the right image's disparity, at the pixel the left one points to, differs by ``max_px`` px or less.

    False where either is unknown, or the left disparity points outside the image.
    """
    height, width = left.shape
    columns = np.arange(width, dtype=np.float32) - left
    rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)
    there = cv2.remap(
        np.ascontiguousarray(right),
        columns,
        rows,
        # Not bilinear: between a near and a far surface that would invent a disparity which neither has.
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,
    )
    return np.asarray(np.abs(there - left) <= max_px)
