"""Stereo corrects a sky mask: what is mostly near is a bright wall and no sky."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from bench.errors import BenchError
from bench.types import Map, Mask

# A part of which stereo knows less than this share is not judged.
_MIN_KNOWN = 0.05


@dataclass(frozen=True)
class NearLimit:
    """Drops the connected parts of a sky mask that stereo finds near.

    A part is near when more than the share ``max_near`` of its known depths is below ``min_depth_m`` metres (0: none
    ever is). Parts are judged as a whole because stereo is wrong in the sky, too: matchers and networks smear the depth
    of trees and signs into it. On KITTI 06, with a limit of 30 m, up to 0.68 of a part of the sky is near, but 0.90 to
    1.00 of a white house, for SGBM, PSMNet, AnyNet and NVTiny. A white house that touches the sky is one part with it,
    and stays.
    """

    min_depth_m: float
    max_near: float

    def __post_init__(self) -> None:
        if self.min_depth_m < 0:
            raise BenchError(f"sky.min_depth_m={self.min_depth_m} is negative; give metres, for example 30, or 0.")
        if not 0.0 < self.max_near < 1.0:
            raise BenchError(f"sky.max_near={self.max_near} is no share between 0 and 1, for example 0.8.")

    def applied(self, sky: Mask, depth: Map) -> Mask:
        """What is left of ``sky`` (H, W); ``depth`` (H, W) in metres, NaN where unknown, which says nothing."""
        count, labels = cv2.connectedComponents(sky.astype(np.uint8), connectivity=4)
        pixels = np.bincount(labels.ravel(), minlength=count)
        known = np.bincount(labels[np.isfinite(depth)], minlength=count)
        near = np.bincount(labels[depth < self.min_depth_m], minlength=count)
        keep = (near <= self.max_near * known) | (known < _MIN_KNOWN * pixels)
        # Label 0 is what is no sky anyway.
        keep[0] = False
        return keep[labels]
