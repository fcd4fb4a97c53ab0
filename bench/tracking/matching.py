"""Candidate pairs of queries and keypoints, their Hamming distances, and one-to-one choice among them."""

from __future__ import annotations

import numpy as np

from bench.tracking.features import Descriptors, Ints
from bench.types import Float

_BAND = 8.0
"""Height in pixels of the row bands of the index."""


class KeypointIndex:
    """Finds all keypoints in axis-aligned boxes, for many boxes at once. Keypoints ``xy`` (N, 2) in pixels."""

    def __init__(self, xy: Float) -> None:
        self._xy = xy
        self._stride = 4.0 * (np.abs(xy).max() + 1.0) if len(xy) else 1.0
        key = np.floor(xy[:, 1] / _BAND) * self._stride + xy[:, 0]
        self._order = np.argsort(key, kind="stable")
        self._key = key[self._order]
        self._bands = (np.floor(xy[:, 1].min() / _BAND), np.floor(xy[:, 1].max() / _BAND)) if len(xy) else (0.0, -1.0)

    def pairs(self, x_low: Float, x_high: Float, y_low: Float, y_high: Float) -> tuple[Ints, Ints]:
        """(query, keypoint) indices of every keypoint inside every query's box; bounds (Q,), inclusive."""
        limit = 0.25 * self._stride
        x_low, x_high = np.clip(x_low, -limit, limit), np.clip(x_high, -limit, limit)
        first = np.clip(np.floor(y_low / _BAND), self._bands[0], None).astype(np.int64)
        last = np.clip(np.floor(y_high / _BAND), None, self._bands[1]).astype(np.int64)
        query, band = expand_ranges(first, last + 1)
        start = np.searchsorted(self._key, band * self._stride + x_low[query], side="left")
        stop = np.searchsorted(self._key, band * self._stride + x_high[query], side="right")
        owner, place = expand_ranges(start, stop)
        query, keypoint = query[owner], self._order[place]
        y = self._xy[keypoint, 1]
        inside = (y >= y_low[query]) & (y <= y_high[query])
        return query[inside], keypoint[inside]


def expand_ranges(start: Ints, stop: Ints) -> tuple[Ints, Ints]:
    """(i, x) for every i and every x in range(start[i], stop[i]); empty ranges give nothing."""
    count = np.maximum(stop - start, 0)
    owner = np.repeat(np.arange(len(start)), count)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return owner, start[owner] + offset


def hamming(a: Descriptors, b: Descriptors) -> Ints:
    """Number of differing bits of descriptors (..., 4) uint64, broadcast over the leading axes."""
    return np.bitwise_count(a ^ b).sum(axis=-1, dtype=np.int64)


def choose_one_to_one(
    query: Ints, keypoint: Ints, distance: Ints, max_distance: int, ratio: float = 1.0
) -> tuple[Ints, Ints, Ints]:
    """The nearest keypoint of every query, and of queries that want the same keypoint the nearest one.

    ``query``, ``keypoint``, ``distance`` (M,) are candidate pairs. A query whose best distance is above
    ``max_distance``, or not below ``ratio`` times its second best (Lowe's test; 1.0 = off), gets nothing. Returns
    (query, keypoint, distance), ordered by query.
    """
    order = np.lexsort((keypoint, distance, query))
    query, keypoint, distance = query[order], keypoint[order], distance[order]
    first = np.diff(query, prepend=-1) != 0
    accepted = first & (distance <= max_distance)
    if ratio < 1.0 and len(query) > 1:
        has_second = np.append(~first[1:], False)
        second = np.append(distance[1:], 0)
        accepted &= ~has_second | (distance < ratio * second)
    query, keypoint, distance = query[accepted], keypoint[accepted], distance[accepted]
    order = np.lexsort((query, distance, keypoint))
    winner = np.sort(order[np.diff(keypoint[order], prepend=-1) != 0])
    return query[winner], keypoint[winner], distance[winner]
