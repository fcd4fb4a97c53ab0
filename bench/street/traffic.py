"""Two cars that drive while the camera does: one ahead of it and faster, one that comes towards it."""

from __future__ import annotations

import numpy as np

from bench.street import objects
from bench.street.objects import Place
from bench.street.path import CenterLine
from bench.street.surfaces import SurfaceList

# Metres to the right of the centre line, ahead of the camera at frame 0, and per frame along the street.
_CARS = ((1.75, 9.0, 1.3), (-1.75, 38.0, -1.0))


def traffic_surfaces(path: CenterLine, position: float, seed: int) -> SurfaceList:
    """The cars where they are at frame ``position`` of a camera that began at the beginning of the path."""
    out = SurfaceList()
    for car, (lane, ahead, speed) in enumerate(_CARS):
        place = Place(*path.beside(max(ahead + speed * position, 0.0), lane))
        objects.add_car(out, np.random.default_rng((seed, 6, car)), place)
    return out
