"""Lays out a street: which things stand where along the path, the same for the same seed however long the drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.street import objects
from bench.street.objects import Place
from bench.street.path import StreetPath
from bench.street.surfaces import SurfaceList, Surfaces, freeze

# Street coordinates d, in metres: half the road with its parking lanes, and where the houses begin.
ROAD_HALF_M = 5.2
PARKED_AT_M = 4.15
SIDEWALK_END_M = 8.4
LANE_CENTER_M = 1.6

_CHUNK_M = 30.0
_SEEN_AHEAD_M = 210.0
_SEEN_BEHIND_M = 30.0
_HILL_CLEARANCE_M = 16.0


@dataclass(frozen=True)
class Street:
    """A street of a given seed: its path, and its things by chunks of 30 m along the path."""

    path: StreetPath
    chunks: dict[int, SurfaceList]

    def seen_from(self, s: float) -> Surfaces:
        """The surfaces that a camera at ``s`` on the path may see: 30 m behind it to 210 m ahead."""
        near = SurfaceList()
        for index in range(_chunk(s - _SEEN_BEHIND_M), _chunk(s + _SEEN_AHEAD_M) + 1):
            near.extend(self.chunks[index])
        return freeze(near)


def _chunk(s: float) -> int:
    return int(np.floor(s / _CHUNK_M))


def build_street(seed: int, length: float) -> Street:
    """A street for a drive from s = 0 to ``length`` metres."""
    first, last = _chunk(-_SEEN_BEHIND_M), _chunk(length + _SEEN_AHEAD_M)
    # The path goes on well beyond the last chunk: its later bends decide where hills may stand.
    path = StreetPath(np.random.default_rng((seed, 0)), (first - 1) * _CHUNK_M, (last + 1) * _CHUNK_M + 200.0)
    chunks = {}
    for index in range(first, last + 1):
        # A generator of its own for every chunk: a longer drive begins with the same street.
        rng = np.random.default_rng((seed, 1, index - first))
        chunks[index] = _build_chunk(rng, path, index * _CHUNK_M)
    return Street(path, chunks)


def _build_chunk(rng: np.random.Generator, path: StreetPath, start: float) -> SurfaceList:
    out = SurfaceList()
    for side in (-1.0, 1.0):
        _add_house_row(out, rng, path, start, side)
        _add_parked_cars(out, rng, path, start, side)
        _add_street_furniture(out, rng, path, start, side)
    _add_hills(out, rng, path, start)
    return out


def _add_house_row(out: SurfaceList, rng: np.random.Generator, path: StreetPath, start: float, side: float) -> None:
    s = start
    while s < start + _CHUNK_M - 4.0:
        width = min(float(rng.uniform(7.0, 13.0)), start + _CHUNK_M - s)
        if width < 5.5 or rng.random() < 0.17:
            _add_garden(out, rng, path, s, width, side)
        else:
            d = side * (SIDEWALK_END_M + float(rng.uniform(0.0, 0.8)))
            objects.add_house(out, rng, Place(*path.beside(s + width / 2, d)), width - 0.05, side)
        s += width


def _add_garden(
    out: SurfaceList, rng: np.random.Generator, path: StreetPath, s: float, width: float, side: float
) -> None:
    objects.add_fence(out, rng, Place(*path.beside(s + width / 2, side * (SIDEWALK_END_M + 0.4))), width)
    for _ in range(2):
        x, z, _ = path.beside(s + rng.uniform(0.2, 0.8) * width, side * (SIDEWALK_END_M + rng.uniform(3.0, 9.0)))
        objects.add_tree(out, rng, x, z, float(rng.uniform(1.0, 1.5)))
    for _ in range(3):
        x, z, _ = path.beside(s + rng.uniform(0.1, 0.9) * width, side * (SIDEWALK_END_M + rng.uniform(1.5, 3.0)))
        objects.add_bush(out, rng, x, z)


def _add_parked_cars(out: SurfaceList, rng: np.random.Generator, path: StreetPath, start: float, side: float) -> None:
    for slot in range(5):
        if rng.random() < 0.55:
            x, z, heading = path.beside(start + 3.0 + 6.0 * slot + rng.uniform(-0.4, 0.4), side * PARKED_AT_M)
            turned = heading + (np.pi if side < 0 else 0.0) + rng.normal(0, 0.02)
            objects.add_car(out, rng, Place(x, z, turned))


def _add_street_furniture(
    out: SurfaceList, rng: np.random.Generator, path: StreetPath, start: float, side: float
) -> None:
    d = side * (ROAD_HALF_M + 0.6)
    objects.add_lamp(out, rng, Place(*path.beside(start + (8.0 if side > 0 else 22.0), d)), side)
    for s in (2.0, 15.5, 28.0):
        if rng.random() < 0.5:
            x, z, _ = path.beside(start + s + rng.uniform(-1, 1), side * (ROAD_HALF_M + 0.9))
            objects.add_tree(out, rng, x, z, float(rng.uniform(0.75, 1.05)))
    if rng.random() < 0.6:
        objects.add_sign(out, rng, Place(*path.beside(start + rng.uniform(4, 26), side * (ROAD_HALF_M + 0.35))))


def _add_hills(out: SurfaceList, rng: np.random.Generator, path: StreetPath, start: float) -> None:
    line = np.array([path.at(s)[:2] for s in np.arange(start - 120.0, start + 200.0, 4.0)])
    for side in (-1.0, 1.0):
        radius = float(rng.uniform(20.0, 36.0))
        d = side * (radius + SIDEWALK_END_M + _HILL_CLEARANCE_M + rng.uniform(0.0, 15.0))
        x, z, _ = path.beside(start + 0.5 * _CHUNK_M, d)
        if np.hypot(*(line - (x, z)).T).min() > radius + SIDEWALK_END_M + _HILL_CLEARANCE_M - 1.0:
            objects.add_hill(out, rng, x, z, radius)
