"""Which pixels of a frame add points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch

from bench.baselines.point_slam.cloud import PointCloud
from bench.baselines.point_slam.frames import MappedFrame, places_of
from bench.baselines.point_slam.settings import PointSlamMapperConfig
from bench.types import Map, StereoCamera

if TYPE_CHECKING:
    from torch import Generator

_POOL = 5
"""Edge pixels are drawn from so many times as many."""
_MEDIAN_M, _MOST = 2.5, 3.0


def candidates(
    frame: MappedFrame, edge: Map, config: PointSlamMapperConfig, first: bool, random: Generator
) -> npt.NDArray[np.int64]:
    """Flat indices of pixels that may add points: random ones, then some of the strongest edges; none twice."""
    known = frame.known
    count = config.uniform_pixels
    if first and len(known):
        median = float(np.median(frame.depth.reshape(-1)[known]))
        count = int(count * np.clip((median / _MEDIAN_M) ** 2, 1.0, _MOST))
    order = torch.randperm(len(known), generator=random).numpy()
    drawn = known[order[:count]]
    if config.edge_pixels:
        strength = edge.reshape(-1)[known]
        strongest = np.argsort(-strength, kind="stable")[: _POOL * config.edge_pixels]
        some = torch.randperm(len(strongest), generator=random).numpy()[: config.edge_pixels]
        drawn = np.concatenate([drawn, np.setdiff1d(known[strongest[some]], drawn)])
    return drawn


def add_points(
    cloud: PointCloud,
    frame: MappedFrame,
    pixels: npt.NDArray[np.int64],
    camera: StereoCamera,
    config: PointSlamMapperConfig,
    random: Generator,
) -> int:
    """Let pixels whose place has no point within its radius add ``layers`` points on their ray; the number of points.

    The cloud of before the frame decides: pixels of one frame don't keep each other from adding, as in the original.
    """
    if not len(pixels):
        return 0
    radius = frame.add_radius.reshape(-1)[pixels]
    distance, _ = cloud.nearest(places_of(frame, pixels, camera), 1, float(radius.max()))
    free = pixels[distance[:, 0] > radius]
    shares = 1.0 + config.layer_share * (np.linspace(-1.0, 1.0, config.layers) if config.layers > 1 else np.zeros(1))
    if len(free):
        cloud.add(np.concatenate([places_of(frame, free, camera, share) for share in shares]), frame.number, random)
    return len(free) * config.layers
