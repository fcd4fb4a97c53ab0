"""Features of an image, and ORB's, spread evenly over image and octaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bench import _native
from bench.tracking.descriptors import Descriptors, Ints
from bench.tracking.orb_tests import comparisons
from bench.types import Float

Grey = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Features:
    """N keypoints of one image: ``xy`` (N, 2) float64 in pixels of the full image (pixel centres at integers),
    ``octave`` (N,), ``descriptors`` (N, 4) uint64 or (N, 64) int8."""

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


class Extractor(Protocol):
    """Finds and describes keypoints, in ``octaves`` images of which each is ``scale_factor`` times as small as the one
    before, to ``sigma_px`` pixels of their octave. All its descriptors are of one kind. Threads may share it."""

    octaves: int
    scale_factor: float
    sigma_px: float

    def extract(self, image: Grey) -> tuple[Features, Pyramid]:
        """Features and pyramid of a grey image (H, W) uint8; no features at all from an image without texture."""
        ...


class OrbExtractor:
    """FAST-scored ORB, spread over the image: about ``count`` keypoints, chosen by buckets in each octave.

    ORB: Rublee et al., ICCV 2011. Octave o gets a share of ``count`` proportional to scale_factor ** -o (as in
    Mur-Artal and Tardos, ORB-SLAM2, 2017), the strongest corner of every bucket of 30 pixels first, then every second
    strongest, and so on. Without the buckets the keypoints crowd on a few textured places and drift grows by a quarter.
    Threads may share an extractor.
    """

    sigma_px = 1.0

    def __init__(self, count: int, octaves: int = 8, scale_factor: float = 1.2, fast_threshold: int = 10) -> None:
        self.octaves = octaves
        self.scale_factor = scale_factor
        self._native = _native.OrbExtractor(count, octaves, scale_factor, fast_threshold, comparisons())

    def extract(self, image: Grey) -> tuple[Features, Pyramid]:
        """Features and pyramid of a grey image (H, W) uint8; no features at all from an image without texture."""
        image = np.ascontiguousarray(image)
        height, width = image.shape
        xy, octave, descriptors, smaller = self._native.extract(image)
        levels = (image, *smaller)
        ratio = np.array([(width / level.shape[1], height / level.shape[0]) for level in levels])
        return Features(xy, octave, descriptors), Pyramid(levels, ratio)
