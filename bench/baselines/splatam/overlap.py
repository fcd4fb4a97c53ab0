"""Which stored keyframes SplaTAM optimises the map with: a random few of those that see what the new frame sees."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.geometry.pinhole import directions, inside, project, to_world
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
    return float(inside(*project(points, view.T_world_cam, view), view, _BORDER_PX).mean())


def _points(view: PinholeView, depth: Map, random: np.random.Generator) -> Float:
    """Points (N, 3) in the world of randomly drawn pixels of known depth, some of them twice."""
    rows, columns = np.nonzero(depth > 0)
    if not len(rows):
        return np.zeros((0, 3))
    drawn = random.integers(len(rows), size=_PIXELS)
    v, u = rows[drawn], columns[drawn]
    points = to_world(directions(u, v, view) * depth[v, u].astype(np.float64)[:, None], view.T_world_cam)
    return points[(np.abs(points) > _ORIGIN_M).any(axis=1)]
