"""The street's centre line: straight pieces and arcs, and the way between plane coordinates and street coordinates.

The world is x right, y down, z forward, with the ground at y = 0. A heading of 0 looks along +z, a positive one to the
right (+x). Street coordinates of a ground point are s (metres along the centre line) and d (metres to its right).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.types import Float, Map

# Beyond this angle the street turns back, so that it never crosses itself.
_MAX_HEADING = np.deg2rad(60.0)
_STRAIGHT_M = (16.0, 42.0)
_FIRST_STRAIGHT_M = 9.0
_RADIUS_M = (24.0, 45.0)
_TURN = np.deg2rad([22.0, 60.0])


@dataclass(frozen=True)
class Piece:
    """One straight (``curvature`` 0) or arc (1 / metres, positive to the right), starting at ``s`` in (x, z)."""

    s: float
    length: float
    x: float
    z: float
    heading: float
    curvature: float

    def at(self, s: Float | float) -> tuple[Float, Float, Float]:
        """x, z and heading of the centre line at ``s`` (any shape)."""
        along = np.asarray(s, dtype=np.float64) - self.s
        heading = self.heading + self.curvature * along
        if self.curvature == 0.0:
            return self.x + along * np.sin(heading), self.z + along * np.cos(heading), heading
        radius = 1.0 / self.curvature
        x = self.x - radius * (np.cos(heading) - np.cos(self.heading))
        z = self.z + radius * (np.sin(heading) - np.sin(self.heading))
        return x, z, heading


class CenterLine(ABC):
    """A street's centre line as a row of pieces, each beginning where the one before ends."""

    pieces: list[Piece]

    def at(self, s: float) -> tuple[float, float, float]:
        """x, z and heading of the centre line at ``s``."""
        starts = [piece.s for piece in self.pieces]
        index = max(0, int(np.searchsorted(starts, s, side="right")) - 1)
        x, z, heading = self.pieces[index].at(s)
        return float(x), float(z), float(heading)

    def beside(self, s: float, d: float) -> tuple[float, float, float]:
        """x and z of the point at street coordinates (s, d), and the street's heading there."""
        x, z, heading = self.at(s)
        return x + d * np.cos(heading), z - d * np.sin(heading), heading

    @abstractmethod
    def locate(self, x: Map, z: Map, s_from: float, s_to: float) -> tuple[Map, Map, Map]:
        """Street coordinates s, d and the heading, each (N,) float32, of ground points (N,) on the nearest piece.

        An open street looks only at the pieces between ``s_from`` and ``s_to``.
        """


class StreetPath(CenterLine):
    """Centre line from ``start`` to at least ``end`` metres; a longer one with the same seed begins the same way."""

    def __init__(self, rng: np.random.Generator, start: float, end: float) -> None:
        """``start`` is negative: the street behind the first camera, which stands at s = 0, (0, 0), heading 0."""
        self.pieces = [Piece(start, _FIRST_STRAIGHT_M - start, 0.0, start, 0.0, 0.0)]
        while self.pieces[-1].s + self.pieces[-1].length < end:
            last = self.pieces[-1]
            s = last.s + last.length
            x, z, heading = (float(value) for value in last.at(s))
            length, turn, radius = rng.uniform(*_STRAIGHT_M), rng.uniform(*_TURN), rng.uniform(*_RADIUS_M)
            right = rng.random() < 0.5
            if last.curvature != 0.0:
                self.pieces.append(Piece(s, length, x, z, heading, 0.0))
                continue
            sign = 1.0 if right else -1.0
            if abs(heading + sign * turn) > _MAX_HEADING:
                sign = -sign
            self.pieces.append(Piece(s, radius * turn, x, z, heading, sign / radius))

    def locate(self, x: Map, z: Map, s_from: float, s_to: float) -> tuple[Map, Map, Map]:
        """See ``CenterLine.locate``; the first and the last piece go on straight, so that every point has a piece."""
        near = [piece for piece in self.pieces if piece.s + piece.length > s_from and piece.s < s_to]
        lows = [-np.inf, *(piece.s for piece in near[1:])]
        highs = [*(piece.s + piece.length for piece in near[:-1]), np.inf]
        return nearest_piece(near, lows, highs, x, z)


def nearest_piece(
    pieces: Sequence[Piece], lows: Sequence[float], highs: Sequence[float], x: Map, z: Map
) -> tuple[Map, Map, Map]:
    """s, d and heading, each (N,) float32, of points (N,) on the piece nearest to each.

    A piece serves the points with ``low <= s < high``, and d is 1000 for a point that no piece serves.
    """
    s_best = np.zeros_like(x)
    d_best = np.full_like(x, np.inf)
    heading_best = np.zeros_like(x)
    for piece, low, high in zip(pieces, lows, highs, strict=True):
        s, d, heading = _street_coordinates(piece, x, z)
        better = (s >= low) & (s < high) & (np.abs(d) < np.abs(d_best))
        s_best, d_best = np.where(better, s, s_best), np.where(better, d, d_best)
        heading_best = np.where(better, heading, heading_best)
    d_best[np.isinf(d_best)] = 1e3
    return s_best, d_best, heading_best


def _street_coordinates(piece: Piece, x: Map, z: Map) -> tuple[Map, Map, Map | np.float32]:
    """s and d of points with respect to one piece, continued beyond its ends, and the heading there."""
    if piece.curvature == 0.0:
        sin, cos = np.float32(np.sin(piece.heading)), np.float32(np.cos(piece.heading))
        dx, dz = x - np.float32(piece.x), z - np.float32(piece.z)
        return np.float32(piece.s) + dx * sin + dz * cos, dx * cos - dz * sin, np.float32(piece.heading)
    radius = 1.0 / piece.curvature
    sign = np.float32(np.sign(radius))
    # Centre of the circle; seen from there the point's direction gives the heading, its distance gives d.
    dx = x - np.float32(piece.x + radius * np.cos(piece.heading))
    dz = z - np.float32(piece.z - radius * np.sin(piece.heading))
    heading = np.arctan2(sign * dz, -sign * dx)
    turn = (heading - np.float32(piece.heading) + np.float32(np.pi)) % np.float32(2 * np.pi) - np.float32(np.pi)
    d = np.float32(radius) - sign * np.hypot(dx, dz)
    return np.float32(piece.s) + turn * np.float32(radius), d, np.float32(piece.heading) + turn
