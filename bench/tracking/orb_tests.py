"""The 256 comparisons that make up an ORB descriptor."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

_REACH = 13
"""The comparisons lie within this many pixels of the keypoint, in x and in y."""
_IMAGES = 64
_SIDE = 101


@lru_cache(maxsize=1)
def comparisons() -> npt.NDArray[np.float32]:
    """(4, 256): ax, ay, bx, by in pixels; bit i says whether the blurred image is darker at a_i than at b_i.

    ORB's comparisons were learned (Rublee et al., ICCV 2011, Sec. 4.3) and are the same in every implementation. They
    are read off OpenCV's: described at one keypoint in 64 images of noise, each pair of pixels answers in its own way.
    """
    noise = np.random.default_rng(0).integers(0, 256, (_IMAGES, _SIDE, _SIDE), dtype=np.uint8)
    centre = _SIDE // 2
    keypoint = cv2.KeyPoint(float(centre), float(centre), 31.0, 0.0)
    orb = cv2.ORB.create(nlevels=1)
    answers = np.array([np.unpackbits(orb.compute(image, [keypoint])[1][0], bitorder="little") for image in noise])
    wanted = (answers.astype(np.uint64) << np.arange(_IMAGES, dtype=np.uint64)[:, None]).sum(axis=0, dtype=np.uint64)
    around, kernel = slice(centre - _REACH, centre + _REACH + 1), cv2.getGaussianKernel(7, 2)
    blurred = np.array([cv2.sepFilter2D(image, -1, kernel, kernel)[around, around].ravel() for image in noise])
    pairs = blurred.shape[1]
    codes = np.zeros((pairs, pairs), dtype=np.uint64)
    for k, values in enumerate(blurred):
        codes |= (values[:, None] < values[None, :]).astype(np.uint64) << np.uint64(k)
    found = _nearest(codes.ravel(), wanted)
    a, b = np.divmod(found, pairs)
    side = 2 * _REACH + 1
    return np.array([a % side, a // side, b % side, b // side], dtype=np.float32) - _REACH


def _nearest(codes: npt.NDArray[np.uint64], wanted: npt.NDArray[np.uint64]) -> npt.NDArray[np.int64]:
    """Place of the code nearest to each wanted one: builds of OpenCV round the blur differently."""
    order = np.argsort(codes)
    found = order[np.minimum(np.searchsorted(codes, wanted, sorter=order), len(codes) - 1)]
    for i in np.flatnonzero(codes[found] != wanted):
        found[i] = np.bitwise_count(codes ^ wanted[i]).argmin()
    return found
