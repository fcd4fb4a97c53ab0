"""ORB features, spread evenly over image and octaves."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bench.types import Float

Grey = npt.NDArray[np.uint8]
Ints = npt.NDArray[np.int64]
Descriptors = npt.NDArray[np.uint64]

_CELL = 30
"""Side of a bucket in pixels of the keypoint's octave."""
_OVERDETECTION = 4


@dataclass(frozen=True)
class Features:
    """N keypoints of one image: ``xy`` (N, 2) float64 in pixels of the full image (pixel centres at integers),
    ``octave`` (N,), ``descriptors`` (N, 4) uint64, 256 bits each."""

    xy: Float
    octave: Ints
    descriptors: Descriptors

    def __len__(self) -> int:
        return len(self.xy)


@dataclass(frozen=True)
class Pyramid:
    """Octave images; ``ratio`` (L, 2) is full size / octave size in x and y (close to scale_factor ** octave)."""

    levels: tuple[Grey, ...]
    ratio: Float

    def to_octave(self, xy: Float, octave: Ints) -> Float:
        """Positions (N, 2) in pixels of the full image -> in pixels of their octave; pixel centres at integers."""
        return (xy + 0.5) / self.ratio[octave] - 0.5

    def to_full(self, xy: Float, octave: Ints) -> Float:
        """Inverse of ``to_octave``."""
        return (xy + 0.5) * self.ratio[octave] - 0.5


def grey(image: npt.NDArray[np.uint8]) -> Grey:
    """(H, W) uint8 luma of an RGB image (H, W, 3); a grey image passes through."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


class OrbExtractor:
    """FAST-scored ORB, over-detected and thinned to about ``count`` by buckets in each octave.

    ORB: Rublee et al., ICCV 2011. Octave o gets a share of ``count`` proportional to scale_factor ** -o (as in
    Mur-Artal and Tardos, ORB-SLAM2, 2017). Without the buckets the keypoints crowd on a few textured places and drift
    grows by a quarter. One extractor must not be used by two threads at once.
    """

    def __init__(self, count: int, octaves: int = 8, scale_factor: float = 1.2, fast_threshold: int = 10) -> None:
        self.octaves = octaves
        self.scale_factor = scale_factor
        self._orb = cv2.ORB.create(
            nfeatures=_OVERDETECTION * count,
            scaleFactor=scale_factor,
            nlevels=octaves,
            scoreType=cv2.ORB_FAST_SCORE,
            fastThreshold=fast_threshold,
        )
        share = scale_factor ** -np.arange(octaves, dtype=np.float64)
        self._wanted = np.round(count * share / share.sum()).astype(np.int64)

    def extract(self, image: Grey) -> tuple[Features, Pyramid]:
        """Features and pyramid of a grey image (H, W) uint8; no features at all from an image without texture."""
        pyramid = self._pyramid(image)
        found = self._orb.detect(image)
        if found:
            table = np.array([(*k.pt, k.response, k.octave) for k in found])
            kept = bucketed(table[:, :2], table[:, 2], table[:, 3].astype(np.int64), self.scale_factor, self._wanted)
            found, descriptors = self._orb.compute(image, [found[i] for i in kept])
        if not found:
            return Features(np.empty((0, 2)), np.empty(0, np.int64), np.empty((0, 4), np.uint64)), pyramid
        octave = np.array([k.octave for k in found], dtype=np.int64)
        # OpenCV multiplies octave coordinates by the scale, which forgets that resizing keeps pixel corners and not
        # pixel centres in place: an error of (scale - 1) / 2 pixels, 1.3 in the last octave.
        in_octave = np.asarray(cv2.KeyPoint.convert(found), dtype=np.float64) / self.scale_factor ** octave[:, None]
        xy = pyramid.to_full(in_octave, octave)
        return Features(xy, octave, np.ascontiguousarray(descriptors).view(np.uint64)), pyramid

    def _pyramid(self, image: Grey) -> Pyramid:
        height, width = image.shape
        levels = [image]
        for octave in range(1, self.octaves):
            scale = self.scale_factor**octave
            size = (max(1, round(width / scale)), max(1, round(height / scale)))
            smaller = cv2.resize(levels[-1], size, interpolation=cv2.INTER_LINEAR_EXACT)
            levels.append(np.asarray(smaller, dtype=np.uint8))
        return Pyramid(tuple(levels), np.array([(width / m.shape[1], height / m.shape[0]) for m in levels]))


def bucketed(xy: Float, response: Float, octave: Ints, scale_factor: float, wanted: Ints) -> Ints:
    """Indices of the keypoints to keep: in octave o at most ``wanted[o]``, spread over a grid of buckets.

    The strongest keypoint of every bucket comes first, then every second strongest, and so on until the octave has
    enough. ``xy`` (N, 2) in pixels of the full image, ``response`` (N,), ``octave`` (N,).
    """
    cell = np.floor(xy / (_CELL * scale_factor ** octave[:, None])).astype(np.int64)
    bucket = (octave * 4096 + cell[:, 1]) * 4096 + cell[:, 0]
    order = np.lexsort((-response, bucket))
    new = np.flatnonzero(np.diff(bucket[order], prepend=-1))
    rank = np.empty(len(xy), dtype=np.int64)
    rank[order] = np.arange(len(xy)) - np.repeat(new, np.diff(new, append=len(xy)))
    order = np.lexsort((-response, rank, octave))
    sorted_octave = octave[order]
    place = np.arange(len(xy)) - np.searchsorted(sorted_octave, sorted_octave)
    return order[place < wanted[sorted_octave]]
