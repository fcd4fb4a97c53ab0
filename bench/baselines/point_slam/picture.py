"""Whole views of neural points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from bench.baselines.point_slam.cloud import PointCloud
from bench.baselines.point_slam.frames import directions_of
from bench.baselines.point_slam.rays import RayRenderer, Rays, around
from bench.types import Float, Map, PinholeView, RenderedView

if TYPE_CHECKING:
    from torch import Tensor

_CHUNK = 4096
_STEPS, _NEAR_M = 25, 0.3
_MEANS, _MOST = 5.0, 1.2


def picture(renderer: RayRenderer, view: PinholeView, depth: Map, query_radius: Map) -> RenderedView:
    """A view with its own depth (H, W) in metres, NaN where unknown, and its query radii (H, W) in metres.

    Alpha is 1 where at least half of a ray's samples have neighbours and 0, with colour black, elsewhere.
    """
    s, device = renderer.settings, renderer.cloud.device
    R, centre = view.T_world_cam[:3, :3], view.T_world_cam[:3, 3]
    flat, radius = depth.reshape(-1), query_radius.reshape(-1)
    pixels = np.flatnonzero(np.isfinite(flat))
    z = around(torch.from_numpy(flat[pixels]), s).numpy()
    if s.march and len(pixels):
        reach = min(_MEANS * float(flat[pixels].mean()), _MOST * float(flat[pixels].max()))
        hidden, there = _marched(renderer.cloud, view, np.flatnonzero(~np.isfinite(flat)), radius, reach, s.samples)
        pixels, z = np.concatenate([pixels, hidden]), np.concatenate([z, there])

    def tensor(values: npt.NDArray[Any]) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).to(device)

    color, far, alpha = np.zeros((flat.size, 3), np.float32), np.zeros(flat.size, np.float32), np.zeros(flat.size)
    for k in range(0, len(pixels), _CHUNK):
        part = pixels[k : k + _CHUNK]
        directions = tensor(directions_of(part, view) @ R.T)
        rays = Rays(tensor(centre).expand(len(part), 3), directions, tensor(z[k : k + _CHUNK]), tensor(radius[part]))
        with torch.no_grad():
            shown = renderer.render(rays)
        valid = shown.valid.cpu().numpy()
        color[part] = shown.color.cpu().numpy() * valid[:, None]
        far[part] = shown.depth.cpu().numpy() * valid
        alpha[part] = valid
    shape = depth.shape
    return RenderedView(color.reshape(*shape, 3), far.reshape(shape), alpha.astype(np.float32).reshape(shape))


def _marched(
    cloud: PointCloud, view: PinholeView, pixels: npt.NDArray[np.int64], radius: Map, reach: float, samples: int
) -> tuple[npt.NDArray[np.int64], Float]:
    """Of pixels of unknown depth those whose rays meet points in 25 steps up to ``reach`` metres, and where they are
    sampled (R, samples): between the first two steps with a point in their radius, or between the first and the step
    after it."""
    steps = np.linspace(_NEAR_M, reach, _STEPS)
    R, centre = view.T_world_cam[:3, :3], view.T_world_cam[:3, 3]
    found, z = [pixels[:0]], [np.zeros((0, samples))]
    for k in range(0, len(pixels), _CHUNK):
        part = pixels[k : k + _CHUNK]
        places = centre + (directions_of(part, view) @ R.T)[:, None] * steps[:, None]
        distance, _ = cloud.nearest(places.reshape(-1, 3), 1, float(radius[part].max()))
        hit = distance.reshape(len(part), _STEPS) <= radius[part, None]
        part, hit = part[hit.any(1)], hit[hit.any(1)]
        first = hit.argmax(1)
        after = hit & (np.arange(_STEPS) > first[:, None])
        second = np.where(after.any(1), after.argmax(1), np.minimum(first + 1, _STEPS - 1))
        shares = np.linspace(0.0, 1.0, samples)
        found.append(part)
        z.append(steps[first, None] + (steps[second] - steps[first])[:, None] * shares)
    return np.concatenate(found), np.concatenate(z)
