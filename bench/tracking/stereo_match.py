"""Sub-pixel disparities of the left image's keypoints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from bench.tracking.features import Features, Grey, Ints, Pyramid
from bench.tracking.matching import KeypointIndex, choose_one_to_one, hamming
from bench.types import Float, Mask, StereoCamera

_MAX_HAMMING = 75
_NEAREST = 4.0
"""Least depth, in baselines, that is looked for: on a car nothing is nearer, and a short search is a fast one."""
_ROW_TOLERANCE = 2.0
"""Rows, in pixels of the keypoint's octave, by which a match may leave its epipolar line."""
_HALF_WINDOW = 5
"""The window is 11 x 11 pixels."""
_SEARCH = 5
"""Pixels of the octave by which the window may correct the matched keypoint."""
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
    offset, rms, good = _refine(left, right, pair_left, pair_right, left_pyramid, right_pyramid)
    if not good.any():
        return disparity
    good &= rms <= _OUTLIER * np.median(rms[good]) + _NOISE
    pair_left, offset = pair_left[good], offset[good]
    raw = offset * left_pyramid.ratio[left.octave[pair_left], 0]
    u_right = left.xy[pair_left, 0] - raw
    ideal = camera.fx * camera.baseline
    raw = raw * ideal / (ideal - (u_right - camera.cx) * camera.right_position[2])
    disparity[pair_left] = np.where(raw > 0, raw, np.nan)
    return disparity


def _pair(left: Features, right: Features, pyramid: Pyramid, camera: StereoCamera) -> tuple[Ints, Ints]:
    x, y = left.xy[:, 0], left.xy[:, 1]
    band = _ROW_TOLERANCE * pyramid.ratio[left.octave, 1]
    query, keypoint = KeypointIndex(right.xy).pairs(x - camera.fx / _NEAREST, x + 1.0, y - band, y + band)
    near = np.abs(left.octave[query] - right.octave[keypoint]) <= 1
    query, keypoint = query[near], keypoint[near]
    distance = hamming(left.descriptors[query], right.descriptors[keypoint])
    pair_left, pair_right, _ = choose_one_to_one(query, keypoint, distance, _MAX_HAMMING)
    return pair_left, pair_right


def _refine(
    left: Features, right: Features, pair_left: Ints, pair_right: Ints, left_pyramid: Pyramid, right_pyramid: Pyramid
) -> tuple[Float, Float, Mask]:
    """Disparity in octave pixels (M,), RMS difference (M,), and whether there is a minimum (M,)."""
    octave = left.octave[pair_left]
    at_left = np.rint(left_pyramid.to_octave(left.xy[pair_left], octave)).astype(np.int64)
    at_right = np.rint(right_pyramid.to_octave(right.xy[pair_right], octave)).astype(np.int64)
    at_right[:, 1] = at_left[:, 1]
    offset, rms = np.zeros(len(octave)), np.full(len(octave), np.inf)
    good = np.zeros(len(octave), dtype=bool)
    for level, (left_image, right_image) in enumerate(zip(left_pyramid.levels, right_pyramid.levels, strict=True)):
        height, width = left_image.shape
        margin = _HALF_WINDOW + _SEARCH
        x0, y0, x1 = at_left[:, 0], at_left[:, 1], at_right[:, 0]
        inside = (octave == level) & (y0 >= _HALF_WINDOW) & (y0 < height - _HALF_WINDOW)
        inside &= (x0 >= _HALF_WINDOW) & (x0 < width - _HALF_WINDOW) & (x1 >= margin) & (x1 < width - margin)
        chosen = np.flatnonzero(inside)
        if len(chosen) == 0:
            continue
        cost = _ssd_profile(left_image, right_image, at_left[chosen], at_right[chosen])
        best = np.argmin(cost, axis=1)
        interior = (best > 0) & (best < 2 * _SEARCH)
        chosen, cost, best = chosen[interior], cost[interior], best[interior]
        row = np.arange(len(chosen))
        before, centre, after = cost[row, best - 1], cost[row, best], cost[row, best + 1]
        curvature = before + after - 2.0 * centre
        shift = np.where(curvature > 0, 0.5 * (before - after) / np.where(curvature > 0, curvature, 1.0), 0.0)
        offset[chosen] = at_left[chosen, 0] - (at_right[chosen, 0] + best - _SEARCH + shift)
        rms[chosen] = np.sqrt(centre) / (2 * _HALF_WINDOW + 1)
        good[chosen] = curvature > 0
    return offset, rms, good


def _ssd_profile(left: Grey, right: Grey, at_left: Ints, at_right: Ints) -> npt.NDArray[np.float32]:
    """Cost (M, 2 * _SEARCH + 1) of each left window against right windows shifted by -_SEARCH .. _SEARCH pixels.

    Sum of squared differences of windows less their means, from moments: |w|^2 + |q|^2 - 2 w.q.
    """
    side = 2 * _HALF_WINDOW + 1
    span = np.arange(-_HALF_WINDOW, _HALF_WINDOW + 1)
    wide = np.arange(-_HALF_WINDOW - _SEARCH, _HALF_WINDOW + _SEARCH + 1)
    rows = at_left[:, 1, None, None] + span[None, :, None]
    window = left[rows, at_left[:, 0, None, None] + span].astype(np.float32)
    strip = right[rows, at_right[:, 0, None, None] + wide].astype(np.float32)
    mean = window.mean(axis=(1, 2), keepdims=True)
    window -= mean
    strip -= mean  # keeps the sums small, and so their digits
    cross = np.einsum("mij,misj->ms", window, sliding_window_view(strip, side, axis=2))
    total = sliding_window_view(strip.sum(axis=1), side, axis=1).sum(axis=2)
    square = sliding_window_view((strip**2).sum(axis=1), side, axis=1).sum(axis=2)
    own = (window**2).sum(axis=(1, 2))[:, None]
    return np.maximum(own + square - total**2 / side**2 - 2.0 * cross, 0.0)
