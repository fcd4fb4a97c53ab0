"""What is wrong with a stereo pair in which too few keypoints find their partner on the epipolar line."""

from __future__ import annotations

import logging

import numpy as np

from bench.tracking.features import Features
from bench.tracking.relocalise import match_descriptors
from bench.types import Float

log = logging.getLogger(__name__)

_SUSPICIOUS_SHARE = 0.3
"""Keypoints with a disparity: 35 % and more on KITTI and on the street, 2 % on swapped pairs, 25 % when rows are 3
pixels off."""
_ATTEMPTS = 10
"""Frames that are looked at before the pair is taken as good: the first ones may be black or blurred."""
_RATIO = 0.8
_LEAST_MATCHES = 30
_ROWS_AGREE = 3.0
"""Rows by which a match may differ from the median offset and still agree with it."""
_AGREEING_SHARE = 0.6
_LEAST_ROW_OFFSET = 2.0
_SWAPPED_SHARE = 0.7
"""Matches with a disparity below -0.5 pixels: none on good pairs, 87 % and more on swapped ones."""


def fault_of_pair(left: Features, right: Features) -> str | None:
    """One sentence on what is wrong with a pair, from matches without any constraint on rows or disparities; or None.

    Finds images whose rows are out of line by more than 2 pixels, and left and right images that are swapped.
    """
    a, b = match_descriptors(left.descriptors, right.descriptors, _RATIO)
    if len(a) < _LEAST_MATCHES:
        return None
    disparity, rows = (left.xy[a] - right.xy[b]).T
    offset = float(np.median(-rows))
    agree = np.abs(rows + offset) < _ROWS_AGREE
    if agree.mean() < _AGREEING_SHARE:
        return None
    if abs(offset) > _LEAST_ROW_OFFSET:
        side = "lower" if offset > 0 else "higher"
        return (
            f"the right image's rows lie {abs(offset):.1f} pixels {side} than the left's "
            f"(median of {len(a)} descriptor matches); the pair is not rectified. Check the rectification, and that "
            "both images belong to the same camera pair and moment."
        )
    negative = float((disparity[agree] < -0.5).mean())
    if negative > _SWAPPED_SHARE:
        return (
            f"left and right images seem to be swapped: {negative:.0%} of {int(agree.sum())} descriptor matches have a "
            "negative disparity. Swap the two cameras in the data set."
        )
    return None


class PairCheck:
    """Looks at the first frames and warns once; costs nothing while stereo matching works."""

    def __init__(self) -> None:
        self._attempts_left = _ATTEMPTS

    def look(self, left: Features, right: Features, disparity: Float) -> None:
        """Judge a frame by its features and the disparities (N,) of the left ones, NaN = no partner."""
        if self._attempts_left == 0 or len(left) == 0:
            return
        share = float(np.isfinite(disparity).mean())
        self._attempts_left -= 1
        if share >= _SUSPICIOUS_SHARE:
            return
        fault = fault_of_pair(left, right)
        if fault is not None:
            log.warning("Only %.0f %% of the keypoints have a stereo match: %s", 100.0 * share, fault)
            self._attempts_left = 0
