"""Which stored keyframes SplaTAM optimises the map with: a random few of those that see what the new frame sees."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.types import Float, Map, PinholeView

_PIXELS = 1600
_BORDER_PX = 20
_ORIGIN_M = 1e-4


def overlap_window(
    view: PinholeView, depth: Map, stored: Mapping[int, PinholeView], size: int, random: np.random.Generator
) -> list[int]:
    """Numbers of at most ``size - 1`` stored keyframes to learn from beside the new frame; the last one is among them.

    The others are drawn from those in which a share above 0 of the new frame's points lies. ``depth`` (H, W) metres, 0
    where unknown, belongs to the new frame's ``view``. ``stored``: keyframes in the order in which they were stored.
    """
    if not stored:
        return []
    *older, last = stored
    points = _points(view, depth, random)
    seen = [number for number in older if share_inside(points, stored[number]) > 0]
    return [*random.permutation(seen).astype(int).tolist()[: max(size - 2, 0)], last]


def share_inside(points: Float, view: PinholeView) -> float:
    """Share of the ``points`` (N, 3), in the world, that lie before a view and 20 px inside its image; 0 of none."""
    if not len(points):
        return 0.0
    x, y, z = (points @ view.T_cam_world[:3, :3].T + view.T_cam_world[:3, 3]).T
    before = z > 0
    z = np.where(before, z, 1.0)
    u, v = view.fx * x / z + view.cx, view.fy * y / z + view.cy
    in_width = (u > _BORDER_PX) & (u < view.width - _BORDER_PX)
    in_height = (v > _BORDER_PX) & (v < view.height - _BORDER_PX)
    return float((before & in_width & in_height).mean())


def _points(view: PinholeView, depth: Map, random: np.random.Generator) -> Float:
    """Points (N, 3) in the world of randomly drawn pixels of known depth, some of them twice."""
    rows, columns = np.nonzero(depth > 0)
    if not len(rows):
        return np.zeros((0, 3))
    drawn = random.integers(len(rows), size=_PIXELS)
    v, u = rows[drawn], columns[drawn]
    z = depth[v, u].astype(np.float64)
    in_camera = np.stack([(u - view.cx) / view.fx * z, (v - view.cy) / view.fy * z, z], 1)
    points = in_camera @ view.T_world_cam[:3, :3].T + view.T_world_cam[:3, 3]
    return points[(np.abs(points) > _ORIGIN_M).any(axis=1)]
