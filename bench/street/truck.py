"""A lorry with a trailer that overtakes the camera in the oncoming lane and hides about half of what it sees."""

from __future__ import annotations

import numpy as np

from bench.street import objects
from bench.street.objects import Place
from bench.street.path import CenterLine
from bench.street.surfaces import Look, Material, SurfaceList

# Distance of its middle to the right of the centre line, and the size of its two units, in metres.
_LANE_M = -0.9
_UNIT_LENGTH_M = 7.8
_GAP_M = 0.7
_HALF_WIDTH_M = 1.25
_HEIGHT_M = 3.8
# Metres per frame that it is faster than the camera: while it comes and goes, and while it is alongside.
_PASSING_M = 1.0
_ALONGSIDE_M = 0.06
# Where its rear end is, ahead of the camera, in the first frame that it covers about half of.
_REAR_M = -0.5


def rear_ahead_m(position: float, covered: tuple[int, int]) -> float:
    """Metres that the lorry's rear end is ahead of the camera at frame ``position``; ``covered`` are the first and the
    last frame in which it stays alongside."""
    first, last = covered
    alongside = min(max(position, first), last)
    return _REAR_M + _ALONGSIDE_M * (alongside - first) + _PASSING_M * (position - alongside)


def truck_surfaces(path: CenterLine, rear_s: float, seed: int) -> SurfaceList:
    """The lorry with its rear end at ``rear_s`` metres along the path: two boxes that follow the bends."""
    out = SurfaceList()
    rng = np.random.default_rng((seed, 5))
    for unit in range(2):
        s = rear_s + (unit + 0.5) * _UNIT_LENGTH_M + unit * _GAP_M
        place = Place(*path.beside(s, _LANE_M))
        look = Look(Material.TRUCK, (0.72, 0.70, 0.64), objects.texture_offset(rng))
        objects.add_lorry_box(out, place, _UNIT_LENGTH_M, _HALF_WIDTH_M, _HEIGHT_M, look)
    return out
