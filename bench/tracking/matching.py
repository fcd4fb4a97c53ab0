"""One-to-one matches of descriptors in boxes around predicted places."""

from __future__ import annotations

import numpy as np

from bench import _native
from bench.tracking.descriptors import Descriptors, Ints
from bench.tracking.features import Features
from bench.types import Float

_OCTAVE_TOLERANCE = 1.5


def expand_ranges(start: Ints, stop: Ints) -> tuple[Ints, Ints]:
    """(i, x) for every i and every x in range(start[i], stop[i]); empty ranges give nothing."""
    count = np.maximum(stop - start, 0)
    owner = np.repeat(np.arange(len(start)), count)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return owner, start[owner] + offset


def one_to_one(wanted: Ints, distance: Ints) -> Ints:
    """Queries (M,), ascending, that get what they want: ``wanted`` (Q,) or -1; of rivals the nearest, then the first.

    ``distance`` (Q,) is the distance of each query to what it wants, or what is ordered as that is.
    """
    query = np.flatnonzero(wanted >= 0)
    order = query[np.lexsort((query, distance[query], wanted[query]))]
    return np.sort(order[np.diff(wanted[order], prepend=-1) != 0])


def match_boxes(
    uv: Float,
    radius: Float,
    octave: Float,
    disparity: Float,
    descriptor: Descriptors,
    features: Features,
    feature_disparity: Float,
    max_distance: int,
    ratio: float,
) -> tuple[Ints, Ints]:
    """(query, keypoint) indices: the keypoint of each query with the nearest descriptor, one-to-one.

    Queries have a place ``uv`` (Q, 2) in pixels, an expected ``octave`` (Q,) and ``disparity`` (Q,), NaN = unknown, and
    a ``descriptor`` (Q, W) of the keypoints' kind. Candidates are the keypoints of ``features`` within ``radius`` (Q,)
    pixels in x and y whose octave is within 1.5 and whose disparity, where known, is within the radius too. A query
    whose best distance is above ``max_distance``, or not below ``ratio`` times its second best (Lowe's test; 1.0 =
    off), gets nothing.
    """
    keypoint, distance = _native.match_boxes(
        uv,
        radius,
        octave,
        disparity,
        descriptor,
        features.xy,
        features.octave,
        feature_disparity,
        features.descriptors,
        max_distance,
        ratio,
        _OCTAVE_TOLERANCE,
    )
    query = one_to_one(keypoint, distance)
    return query, keypoint[query].astype(np.int64)
