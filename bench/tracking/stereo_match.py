"""Sub-pixel disparities of the left image's keypoints."""

from __future__ import annotations

import numpy as np

from bench import _native
from bench.tracking.descriptors import Ints
from bench.tracking.features import Features, Pyramid
from bench.tracking.matching import one_to_one
from bench.types import Float, StereoCamera

_MAX_DISTANCE = 75
_NEAREST = 4.0
"""Least depth, in baselines, that is looked for: on a car nothing is nearer, and a short search is a fast one."""
_ROW_TOLERANCE = 2.0
"""Rows, in pixels of the keypoint's octave, by which a match may leave its epipolar line."""
_BEYOND = 1.0
"""Pixels by which a far point may lie on the wrong side of its epipolar line's end at disparity 0."""
_OUTLIER, _NOISE = 2.1, 2.0
"""Matches whose RMS difference, in grey values, is above _OUTLIER times the median plus _NOISE are dropped."""


def match_stereo(
    left: Features, right: Features, left_pyramid: Pyramid, right_pyramid: Pyramid, camera: StereoCamera
) -> Float:
    """Disparity (N,) in pixels of each left keypoint, NaN where it has none.

    Keypoints are paired by descriptor within a band of rows, then 11x11 windows on the left keypoint's octave give the
    sub-pixel part by a parabola (the scheme of Mur-Artal and Tardos, ORB-SLAM2, 2017). The cost is the sum of squared
    differences less the windows' means, and not ORB-SLAM2's sum of absolute ones: that has a kink where a parabola
    expects a smooth minimum, and on a made-up pair of known shift its error is eight times as large. The result is the
    disparity of an ideal pair, fx * baseline / depth, also where the right camera is off by millimetres in y and z
    (``StereoCamera.right_position``). Points nearer than four baselines are not looked for.
    """
    disparity = np.full(len(left), np.nan)
    pair_left, pair_right = _pair(left, right, left_pyramid, camera)
    offset, rms = _refine(left, right, pair_left, pair_right, left_pyramid, right_pyramid)
    known = np.isfinite(rms)
    if not known.any():
        return disparity
    good = known & (rms <= _OUTLIER * np.median(rms[known]) + _NOISE)
    pair_left, offset = pair_left[good], offset[good]
    raw = offset * left_pyramid.ratio[left.octave[pair_left], 0]
    u_right = left.xy[pair_left, 0] - raw
    ideal = camera.fx * camera.baseline
    raw = raw * ideal / (ideal - (u_right - camera.cx) * camera.right_position[2])
    disparity[pair_left] = np.where(raw > 0, raw, np.nan)
    return disparity


def _pair(left: Features, right: Features, pyramid: Pyramid, camera: StereoCamera) -> tuple[Ints, Ints]:
    best, distance = _native.pair_rows(
        left.xy,
        left.octave,
        left.descriptors,
        right.xy,
        right.octave,
        right.descriptors,
        _ROW_TOLERANCE * pyramid.ratio[left.octave, 1],
        camera.fx / _NEAREST,
        _BEYOND,
        _MAX_DISTANCE,
    )
    pair_left = one_to_one(best, distance)
    return pair_left, best[pair_left].astype(np.int64)


def _refine(
    left: Features, right: Features, pair_left: Ints, pair_right: Ints, left_pyramid: Pyramid, right_pyramid: Pyramid
) -> tuple[Float, Float]:
    """Disparity in octave pixels (M,) and RMS difference (M,) in grey values, NaN without a minimum in the search."""
    octave = left.octave[pair_left]
    at_left = np.rint(left_pyramid.to_octave(left.xy[pair_left], octave)).astype(np.int64)
    x_right = np.rint(right_pyramid.to_octave(right.xy[pair_right], octave)[:, 0]).astype(np.int64)
    return _native.refine_disparity(list(left_pyramid.levels), list(right_pyramid.levels), octave, at_left, x_right)
