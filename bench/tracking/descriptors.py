"""The two kinds of descriptors, how far apart two of a kind are, and what lies in the middle of several.

Binary ones, ORB's, are (N, 4) uint64: 256 bits, compared by the number of differing bits. Real ones, XFeat's, are
(N, 64) int8: vectors, compared by the length of their difference. Those are scaled so that the lengths have ORB's
scale, on which 128 is what lies between two descriptors that have nothing in common; so one set of limits serves both.
"""

from __future__ import annotations

from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from bench.types import Float

Ints = npt.NDArray[np.int64]
Descriptors = npt.NDArray[np.uint64] | npt.NDArray[np.int8]

_UNIT = 115.0
"""int8 steps in 1.0: XFeat's unit vectors from different places are 1.11 apart in the median (KITTI 06)."""
_BLOCK = 255
"""Rows of bytes that may be summed as bytes without overflow, if each is 0 or 1."""


class Metric(Protocol):
    """Distances between descriptors of one kind."""

    def rank(self, a: Descriptors, b: Descriptors) -> Ints:
        """Distances of descriptors (..., W), broadcast over the leading axes, as whole numbers in the same order."""
        ...

    def nearest(self, a: Descriptors, b: Descriptors, count: int) -> tuple[Float, Ints]:
        """Distance and index (A, count) of the nearest of descriptors (B, W) to each of (A, W), nearest first."""
        ...

    def middles(self, descriptors: Descriptors, group: Ints, groups: int) -> Descriptors:
        """Descriptor (groups, W) in the middle of the members of each group; ``group`` (N,) has every number."""
        ...


class _Hamming:
    def rank(self, a: Descriptors, b: Descriptors) -> Ints:
        return np.bitwise_count(a ^ b).sum(axis=-1, dtype=np.int64)

    def nearest(self, a: Descriptors, b: Descriptors, count: int) -> tuple[Float, Ints]:
        return _nearest(a.view(np.uint8), b.view(np.uint8), cv2.NORM_HAMMING, cv2.CV_32S, count)

    def middles(self, descriptors: Descriptors, group: Ints, groups: int) -> Descriptors:
        """The bits that most members have."""
        order = np.argsort(group, kind="stable")
        start = np.searchsorted(group[order], np.arange(groups))
        # Runs of at most 255 rows are summed as bytes, eight to an integer, without overflow: five times as fast.
        run = np.unique(np.concatenate([start, np.arange(0, len(group), _BLOCK)]))
        bits = np.unpackbits(descriptors[order].view(np.uint8), axis=1)
        partial = np.add.reduceat(bits.view(np.uint64), run, axis=0).view(np.uint8)
        ones = np.add.reduceat(partial, np.searchsorted(run, start), axis=0, dtype=np.int64)
        count = np.diff(start, append=len(group))
        return np.packbits(2 * ones > count[:, None], axis=1).view(np.uint64)


class _Euclidean:
    def rank(self, a: Descriptors, b: Descriptors) -> Ints:
        """Squares: whole numbers below 2^23, which float32 holds exactly in any order of summation."""
        difference = a.astype(np.float32) - b
        return np.einsum("...i,...i->...", difference, difference).astype(np.int64)

    def nearest(self, a: Descriptors, b: Descriptors, count: int) -> tuple[Float, Ints]:
        return _nearest(a.astype(np.float32), b.astype(np.float32), cv2.NORM_L2, cv2.CV_32F, count)

    def middles(self, descriptors: Descriptors, group: Ints, groups: int) -> Descriptors:
        """Means."""
        order = np.argsort(group, kind="stable")
        start = np.searchsorted(group[order], np.arange(groups))
        total = np.add.reduceat(descriptors[order], start, axis=0, dtype=np.int64)
        return np.rint(total / np.diff(start, append=len(group))[:, None]).astype(np.int8)


_METRICS: dict[tuple[str, int], Metric] = {("uint64", 4): _Hamming(), ("int8", 64): _Euclidean()}


def are_descriptors(array: npt.NDArray[Any]) -> bool:
    """Whether an array has the type and shape of descriptors of either kind."""
    return array.ndim == 2 and (array.dtype.name, array.shape[1]) in _METRICS


def metric_of(descriptors: Descriptors) -> Metric:
    """How descriptors (N, W) are compared; those that are compared with them must be of the same kind."""
    return _METRICS[descriptors.dtype.name, descriptors.shape[-1]]


def whole_numbers(vectors: npt.NDArray[np.float32]) -> npt.NDArray[np.int8]:
    """Descriptors (N, 64) of unit vectors (N, 64)."""
    return np.clip(np.rint(vectors * _UNIT), -127, 127).astype(np.int8)


def as_they_were(array: npt.NDArray[Any]) -> Descriptors:
    """Descriptors from a checkpoint, where uint64 lies as int64 with the same bits."""
    return array.view(np.uint64) if array.dtype == np.int64 else array


def _nearest(a: npt.NDArray[Any], b: npt.NDArray[Any], norm: int, kind: int, count: int) -> tuple[Float, Ints]:
    distance, index = cv2.batchDistance(a, b, kind, normType=norm, K=count)
    return np.asarray(distance, dtype=np.float64), np.asarray(index).astype(np.int64)
