"""Lays out a street: which things stand where along the path, the same for the same seed however long the drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.street import objects
from bench.street.circuit import CircuitPath
from bench.street.objects import Place
from bench.street.path import CenterLine, StreetPath
from bench.street.surfaces import SurfaceList, Surfaces, freeze
from bench.types import Float

# Street coordinates d, in metres: half the road with its parking lanes, and where the houses begin.
ROAD_HALF_M = 5.2
PARKED_AT_M = 4.15
SIDEWALK_END_M = 8.4
LANE_CENTER_M = 1.6

CHUNK_M = 30.0
_SENSORS_BEHIND_M = 1.0
_SAME_THINGS = 0.5
_SEEN_AHEAD_M = 210.0
_SEEN_BEHIND_M = 30.0
_HILL_CLEARANCE_M = 16.0


@dataclass(frozen=True)
class Street:
    """A street of a given seed: its path, and its things by chunks of 30 m along the path."""

    path: CenterLine
    chunks: dict[int, SurfaceList]

    def seen_from(self, s: float, also: SurfaceList | None = None) -> Surfaces:
        """The surfaces that a camera at ``s`` on the path may see, and those of ``also``."""
        near = SurfaceList()
        for index in self.visible_chunks(s):
            near.extend(self.chunks[index])
        if also is not None:
            near.extend(also)
        return freeze(near)

    def visible_chunks(self, s: float) -> list[int]:
        """Chunks from 30 m behind the camera to 210 m ahead."""
        return list(range(_chunk(s - _SEEN_BEHIND_M), _chunk(s + _SEEN_AHEAD_M) + 1))


@dataclass(frozen=True)
class Circuit(Street):
    """A street that closes on itself: what is seen is chosen on the ground plan, since its far side is near."""

    centers: Float
    """(chunks, 2) x, z of a circle around each chunk, in metres."""
    radii: Float
    """(chunks,) metres."""

    def visible_chunks(self, s: float) -> list[int]:
        """Chunks that have something ahead of the camera and within 210 m."""
        x, z, heading = self.path.at(s)
        away = self.centers - (x, z)
        ahead = away @ (np.sin(heading), np.cos(heading)) + self.radii > -_SENSORS_BEHIND_M
        near = np.hypot(*away.T) - self.radii < _SEEN_AHEAD_M
        return [int(index) for index in np.flatnonzero(ahead & near)]


@dataclass(frozen=True)
class _Random:
    """Where the layout of a chunk draws from; the same generator in all places if nothing repeats."""

    houses: np.random.Generator
    cars: np.random.Generator
    furniture: np.random.Generator
    hills: np.random.Generator


def _random_of(seed: int, chunk: int, repeated: bool) -> _Random:
    """The generators of a chunk: its own, so that a longer drive begins with the same street.

    With ``repeated``, houses, gardens and their textures are the same in every chunk; the cars and the furniture
    (lamps, trees, signs) are each with even odds those that half of the chunks have, or the chunk's own.
    """
    own = np.random.default_rng((seed, 1, chunk))
    if not repeated:
        return _Random(own, own, own, own)
    cars, furniture = (np.random.default_rng((seed, part)) if own.random() < _SAME_THINGS else own for part in (3, 4))
    return _Random(np.random.default_rng((seed, 2)), cars, furniture, own)


def _chunk(s: float) -> int:
    return int(np.floor(s / CHUNK_M))


def build_street(seed: int, length: float, repeated: bool = False) -> Street:
    """A street for a drive from s = 0 to ``length`` metres; ``repeated``: the houses repeat every 30 m."""
    first, last = _chunk(-_SEEN_BEHIND_M), _chunk(length + _SEEN_AHEAD_M)
    # The path goes on well beyond the last chunk: its later bends decide where hills may stand.
    path = StreetPath(np.random.default_rng((seed, 0)), (first - 1) * CHUNK_M, (last + 1) * CHUNK_M + 200.0)
    chunks = {}
    for index in range(first, last + 1):
        start = index * CHUNK_M
        line = _line(path, start - 120.0, start + 200.0)
        chunks[index] = _build_chunk(_random_of(seed, index - first, repeated), path, start, line)
    return Street(path, chunks)


def build_circuit(seed: int, length: float, repeated: bool = False) -> Circuit:
    """A closed street of ``length`` metres, a multiple of 30; ``repeated``: the houses repeat every 30 m."""
    path = CircuitPath(np.random.default_rng((seed, 0)), length)
    line = _line(path, 0.0, length)
    chunks = {
        index: _build_chunk(_random_of(seed, index, repeated), path, index * CHUNK_M, line)
        for index in range(round(length / CHUNK_M))
    }
    centers, radii = zip(*(chunk.bounding_circle() for chunk in chunks.values()), strict=True)
    return Circuit(path, chunks, np.array(centers), np.array(radii))


def _line(path: CenterLine, s_from: float, s_to: float) -> Float:
    """Points (N, 2) x, z of the centre line, 4 m apart."""
    return np.array([path.at(s)[:2] for s in np.arange(s_from, s_to, 4.0)])


def _build_chunk(random: _Random, path: CenterLine, start: float, line: Float) -> SurfaceList:
    """The things of the 30 m from ``start``; hills keep away from the points ``line`` (N, 2) of the centre line."""
    out = SurfaceList()
    for side in (-1.0, 1.0):
        _add_house_row(out, random.houses, path, start, side)
        _add_parked_cars(out, random.cars, path, start, side)
        _add_street_furniture(out, random.furniture, path, start, side)
    _add_hills(out, random.hills, path, start, line)
    return out


def _add_house_row(out: SurfaceList, rng: np.random.Generator, path: CenterLine, start: float, side: float) -> None:
    s = start
    while s < start + CHUNK_M - 4.0:
        width = min(float(rng.uniform(7.0, 13.0)), start + CHUNK_M - s)
        if width < 5.5 or rng.random() < 0.17:
            _add_garden(out, rng, path, s, width, side)
        else:
            d = side * (SIDEWALK_END_M + float(rng.uniform(0.0, 0.8)))
            objects.add_house(out, rng, Place(*path.beside(s + width / 2, d)), width - 0.05, side)
        s += width


def _add_garden(
    out: SurfaceList, rng: np.random.Generator, path: CenterLine, s: float, width: float, side: float
) -> None:
    objects.add_fence(out, rng, Place(*path.beside(s + width / 2, side * (SIDEWALK_END_M + 0.4))), width)
    for _ in range(2):
        x, z, _ = path.beside(s + rng.uniform(0.2, 0.8) * width, side * (SIDEWALK_END_M + rng.uniform(3.0, 9.0)))
        objects.add_tree(out, rng, x, z, float(rng.uniform(1.0, 1.5)))
    for _ in range(3):
        x, z, _ = path.beside(s + rng.uniform(0.1, 0.9) * width, side * (SIDEWALK_END_M + rng.uniform(1.5, 3.0)))
        objects.add_bush(out, rng, x, z)


def _add_parked_cars(out: SurfaceList, rng: np.random.Generator, path: CenterLine, start: float, side: float) -> None:
    for slot in range(5):
        if rng.random() < 0.55:
            x, z, heading = path.beside(start + 3.0 + 6.0 * slot + rng.uniform(-0.4, 0.4), side * PARKED_AT_M)
            turned = heading + (np.pi if side < 0 else 0.0) + rng.normal(0, 0.02)
            objects.add_car(out, rng, Place(x, z, turned))


def _add_street_furniture(
    out: SurfaceList, rng: np.random.Generator, path: CenterLine, start: float, side: float
) -> None:
    d = side * (ROAD_HALF_M + 0.6)
    objects.add_lamp(out, rng, Place(*path.beside(start + (8.0 if side > 0 else 22.0), d)), side)
    for s in (2.0, 15.5, 28.0):
        if rng.random() < 0.5:
            x, z, _ = path.beside(start + s + rng.uniform(-1, 1), side * (ROAD_HALF_M + 0.9))
            objects.add_tree(out, rng, x, z, float(rng.uniform(0.75, 1.05)))
    if rng.random() < 0.6:
        objects.add_sign(out, rng, Place(*path.beside(start + rng.uniform(4, 26), side * (ROAD_HALF_M + 0.35))))


def _add_hills(out: SurfaceList, rng: np.random.Generator, path: CenterLine, start: float, line: Float) -> None:
    for side in (-1.0, 1.0):
        radius = float(rng.uniform(20.0, 36.0))
        d = side * (radius + SIDEWALK_END_M + _HILL_CLEARANCE_M + rng.uniform(0.0, 15.0))
        x, z, _ = path.beside(start + 0.5 * CHUNK_M, d)
        if np.hypot(*(line - (x, z)).T).min() > radius + SIDEWALK_END_M + _HILL_CLEARANCE_M - 1.0:
            objects.add_hill(out, rng, x, z, radius)
