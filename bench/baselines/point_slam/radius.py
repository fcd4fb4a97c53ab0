"""How densely points lie: a radius for each pixel, small where the image has structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.errors import BenchError, require_least
from bench.types import Image, Map

_GREY = np.array([0.2125, 0.7154, 0.0721])
FLAT, EDGE = 0.01, 0.15
"""Sobel magnitudes of a grey image in [0, 1]: up to the first a pixel counts as flat, from the second on as an edge."""

QUERY_FACTOR = 2.0
"""Neighbours are looked for within so many times the distance in which a pixel adds no second point."""


@dataclass(frozen=True)
class RadiusSettings:
    """Distances between points, in metres."""

    flat_m: float = 0.08
    """Least distance of points where the image is flat; neighbours are looked for within twice as much."""
    edge_m: float = 0.02
    """The same at edges of the image."""
    at_depth_m: float = 0.0
    """Depth at which these distances hold; they grow in proportion to it beyond. 0 = they hold everywhere, as in the
    original."""

    def __post_init__(self) -> None:
        require_least("mapper.radius", self, at_depth_m=0)
        if not 0 < self.edge_m <= self.flat_m:
            raise BenchError(
                f"mapper.radius: edge_m={self.edge_m} must be above 0 and at most flat_m={self.flat_m}; the original "
                "has 0.02 and 0.08."
            )


def edges(image: Image) -> Map:
    """Sobel magnitude (H, W) float32 of the grey image in [0, 1]: RGB uint8 (H, W, 3) in."""
    from skimage.filters import sobel  # here: it takes a while to load

    return sobel(image @ _GREY / 255.0).astype(np.float32)


def add_radius(edge: Map, depth: Map, settings: RadiusSettings) -> Map:
    """Distance in metres within which no second point is added, for Sobel magnitudes and depths of equal shape.

    Linear from ``flat_m`` at 0.01 to ``edge_m`` at 0.15, constant outside.
    """
    radius = np.interp(edge, (FLAT, EDGE), (settings.flat_m, settings.edge_m))
    if settings.at_depth_m:
        radius = radius * np.maximum(np.nan_to_num(depth) / settings.at_depth_m, 1.0)
    return radius.astype(np.float32)
