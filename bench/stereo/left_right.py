"""The left-right check: a disparity counts where the right image's own disparity leads back."""

from __future__ import annotations

import cv2
import numpy as np

from bench.contracts.stereo import Matched
from bench.stereo.resizing import Matcher
from bench.types import Image, Map


def left_right_checked(matcher: Matcher, left: Image, right: Image, max_px: float) -> Matched:
    """Disparity (H, W), NaN where the right image's differs by more than ``max_px``: occlusions and wrong matches.

    The confidence is exp(-difference / max_px), 1 where both agree and 0 where the disparity was dropped, times the
    matcher's own if it has one. Costs a second match: the right image's disparities are those of the mirrored pair with
    its sides exchanged.
    """
    disparity, own = matcher(left, right)
    of_right = matcher(mirrored(right), mirrored(left)).disparity[:, ::-1]
    off = disagreement(disparity, of_right)
    kept = off <= max_px
    confidence = np.where(kept, np.exp(-off / np.float32(max_px)), np.float32(0))
    return Matched(np.where(kept, disparity, np.float32(np.nan)), confidence if own is None else confidence * own)


def mirrored(image: Image) -> Image:
    """The image with its columns in reverse order."""
    return np.ascontiguousarray(image[:, ::-1])


def disagreement(left: Map, right: Map) -> Map:
    """By how many pixels (H, W) the right image's disparity, at the pixel that the left one points to, differs.

    NaN where either is unknown, or the left disparity points outside the image.
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
    return np.asarray(np.abs(there - left))
