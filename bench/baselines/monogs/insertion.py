"""New Gaussians of a MonoGS keyframe: a random part of its pixels, whatever the map has there already."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from bench.baselines.monogs.images import not_black
from bench.gaussians.parameters import planes_from
from bench.geometry.pinhole import directions, to_world
from bench.types import Float, Image, Map, PinholeView

if TYPE_CHECKING:
    from torch import Tensor

    from bench.baselines.monogs.images import Exposure

_LEAST_DISTANCE2 = 1e-7
_LARGEST_POINT = 0.05
_NEIGHBOURS = 3
_OPACITY = 0.5


def usable_depth(image: Image, depth: Map, max_depth_m: float) -> Map:
    """Depth (H, W) in metres, 0 where it is unknown (NaN), beyond ``max_depth_m``, or of a black pixel."""
    with np.errstate(invalid="ignore"):
        good = (depth > 0) & (depth <= max_depth_m) & not_black(image)
    return np.where(good, depth, 0.0).astype(np.float32)


def new_gaussians(
    image: Image,
    depth: Map,
    view: PinholeView,
    share: float,
    point_size: float,
    exposure: Exposure,
    random: np.random.Generator,
) -> Tensor:
    """Parameters (14, M) of one Gaussian for each of M = share * n of the n pixels with a ``depth`` (H, W) above 0.

    Round, of opacity 0.5, in the colour of the pixel without the ``exposure``; the variance is ``point_size`` times the
    mean squared distance to the three nearest of the new points.
    """
    v, u = np.nonzero(depth)
    chosen = np.sort(random.choice(len(v), int(len(v) * share), replace=False))
    v, u = v[chosen], u[chosen]
    z = depth[v, u].astype(np.float64)
    points = directions(u, v, view) * z[:, None]
    means = to_world(points, view.T_world_cam)
    sigma = np.sqrt(np.maximum(neighbour_distance2(points), _LEAST_DISTANCE2) * point_size)
    a, b = exposure
    colors = np.clip((image[v, u] / 255.0 - b) * np.exp(-a), 0.0, 1.0)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(v), 1))
    columns = (means, np.repeat(sigma[:, None], 3, 1), upright, np.full(len(v), _OPACITY), colors)
    return planes_from(*(torch.from_numpy(np.ascontiguousarray(each, np.float32)) for each in columns))


def neighbour_distance2(points: Float) -> Float:
    """Mean squared distance (N,) of points (N, 3) to the nearest three others, or as many as there are; 0 for one."""
    count = min(_NEIGHBOURS, len(points) - 1)
    if count < 1:
        return np.zeros(len(points))
    from scipy.spatial import cKDTree  # here: it imports torch

    distances = cKDTree(points).query(points, count + 1)[0][:, 1:]
    return np.asarray((distances**2).mean(1))


def adapted_point_size(point_size: float, depth: Map) -> float:
    """The factor for a keyframe whose ``depth`` (H, W) is 0 where unknown: more where it is far, up to a limit."""
    return min(_LARGEST_POINT, point_size * float(np.median(depth)))
