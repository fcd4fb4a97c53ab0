"""Depth in colours: the same ones for all pictures of a figure or a video."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from bench.contracts.dataset import Dataset
from bench.types import Image, Map

_UNKNOWN = (0.85, 0.85, 0.85, 1.0)
_FARTHEST_SHARE = 0.95
_RETURN_PX = 1 / 400
"""A LiDAR return is drawn as wide as this share of the image: single pixels would be lost in print."""


def depth_scale(max_depth_m: float | None) -> ScalarMappable:
    """Colours from 0 to ``max_depth_m`` (near red, far blue; beyond as there), grey for what is unknown."""
    return ScalarMappable(Normalize(0.0, max_depth_m), colormaps["turbo_r"].with_extremes(bad=_UNKNOWN))


def colored(depth: Map, scale: ScalarMappable) -> Image:
    """(H, W) metres, NaN = unknown, as RGB uint8 (H, W, 3)."""
    return np.asarray(scale.to_rgba(np.ma.masked_invalid(depth), bytes=True)[..., :3], np.uint8)


def known_depth(dataset: Dataset, position: int) -> Map | None:
    """(H, W) metres of the left image: exact, else by a depth camera, else by LiDAR, its returns widened; or None."""
    depth = dataset.true_depth(position)
    if depth is None:
        depth = dataset.sensor_depth(position)
    if depth is None:
        lidar = dataset.lidar_depth(position)
        depth = None if lidar is None else _widened(lidar)
    return depth


def limit_of(truth: Sequence[Map | None], rendered: Sequence[Map]) -> float | None:
    """Metres at which colours should end: the 95 % quantile of the known depth, else of the rendered; None for none."""
    for depths in ([depth for depth in truth if depth is not None], rendered):
        known = np.concatenate([depth[np.isfinite(depth)] for depth in depths] or [np.zeros(0, np.float32)])
        if len(known):
            return float(np.quantile(known, _FARTHEST_SHARE))
    return None


def _widened(lidar: Map) -> Map:
    """Returns as squares, the nearest one in front."""
    side = max(1, round(lidar.shape[1] * _RETURN_PX)) | 1
    nearness = np.nan_to_num(1 / lidar, nan=0.0).astype(np.float32)
    with np.errstate(divide="ignore"):
        depth = 1 / cv2.dilate(nearness, np.ones((side, side), np.uint8))
    return np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)
