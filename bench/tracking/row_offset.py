"""How far matched corners of a left and a right image are off the rows on which a rectified pair has them."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt

from bench.io.images import grey
from bench.tracking.features import OrbExtractor
from bench.tracking.relocalise import match_descriptors
from bench.types import Float, Image

_FEATURES = 1000
_RATIO = 0.8
_WINDOW_PX = 15
_REFINED_PX = 3.0
"""Descriptors match to a pixel or two; what moves farther when it is refined was no corner."""
_BACK_PX = 0.2
"""From left to right and back again, a corner is found where it was to this."""


def matched_rows(left: Image, right: Image) -> tuple[Float, Float]:
    """Corners (M, 2) of the left image and their places (M, 2) in the right one, in pixels, to about a tenth.

    ORB descriptors say which belong together, anywhere in the image; the image itself says where, by Lucas and Kanade.
    """
    first, second = grey(left), grey(right)
    extractor = OrbExtractor(_FEATURES)
    of_left, of_right = (extractor.extract(image)[0] for image in (first, second))
    a, b = match_descriptors(of_left.descriptors, of_right.descriptors, _RATIO)
    if not len(a):
        return np.empty((0, 2)), np.empty((0, 2))
    start, guess = (np.ascontiguousarray(each, np.float32) for each in (of_left.xy[a], of_right.xy[b]))
    there, found = _refined(first, second, start, guess)
    back, found_back = _refined(second, first, there, start)
    near = np.linalg.norm(there - guess, axis=1) < _REFINED_PX
    good = found & found_back & near & (np.linalg.norm(back - start, axis=1) < _BACK_PX)
    return start[good].astype(np.float64), there[good].astype(np.float64)


def _refined(
    image: Image, other: Image, places: npt.NDArray[np.float32], guess: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        image,
        other,
        places,
        guess.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=0,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32), np.asarray(status)[:, 0] == 1


def row_offset(left: Image, right: Image) -> float:
    """Median of |row in the right image - row in the left one| over matched corners, in pixels; NaN without any."""
    return row_offset_of_pairs([(left, right)])[0]


def row_offset_of_pairs(pairs: Iterable[tuple[Image, Image]]) -> tuple[float, int]:
    """As ``row_offset``, over the corners of several pairs together, and how many they are."""
    matched = [matched_rows(left, right) for left, right in pairs]
    off = np.concatenate([np.abs(there[:, 1] - start[:, 1]) for start, there in matched])
    return float(np.median(off)) if len(off) else float("nan"), len(off)
