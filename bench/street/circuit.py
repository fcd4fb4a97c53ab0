"""A closed circuit: a rounded rectangle of streets around one block, driven round and round."""

from __future__ import annotations

import numpy as np

from bench.street.path import CenterLine, Piece, nearest_piece
from bench.types import Map

# As tight as the bends of the open street, so that the houses inside a bend have room.
_RADIUS_M = (24.0, 30.0)
# The first side's share of the straights of two sides.
_FIRST_SIDE = (0.5, 0.62)
# Where on the first side the drive begins.
_START = (0.3, 0.45)
# Pieces overlap by this much, so that rounding leaves no point between them.
_OVERLAP_M = 1e-3


class CircuitPath(CenterLine):
    """Centre line of a circuit of ``length`` metres: four straights and four bends of 90 degrees.

    s and s + length are the same place. It begins at (0, 0) with heading 0; the seed chooses its shape and whether it
    turns right or left.
    """

    def __init__(self, rng: np.random.Generator, length: float) -> None:
        self.length = length
        radius, first_side, start = rng.uniform(*_RADIUS_M), rng.uniform(*_FIRST_SIDE), rng.uniform(*_START)
        sign = 1.0 if rng.random() < 0.5 else -1.0
        straights = length / 2 - np.pi * radius
        long, short = first_side * straights, (1.0 - first_side) * straights
        bend = (0.5 * np.pi * radius, sign / radius)
        begun = start * long
        row = [(long - begun, 0.0), bend, (short, 0.0), bend, (long, 0.0), bend, (short, 0.0), bend, (begun, 0.0)]
        self.pieces: list[Piece] = []
        s, x, z, heading = 0.0, 0.0, 0.0, 0.0
        for piece_length, curvature in row:
            piece = Piece(s, piece_length, x, z, heading, curvature)
            self.pieces.append(piece)
            s += piece_length
            x, z, heading = (float(value) for value in piece.at(s))

    def at(self, s: float) -> tuple[float, float, float]:
        """x, z and heading of the centre line at ``s``, whatever the lap."""
        return super().at(s % self.length)

    def locate(self, x: Map, z: Map, s_from: float, s_to: float) -> tuple[Map, Map, Map]:
        """See ``CenterLine.locate``. All pieces count: a point of the ground looks the same from everywhere."""
        lows = [piece.s - _OVERLAP_M for piece in self.pieces]
        highs = [piece.s + piece.length + _OVERLAP_M for piece in self.pieces]
        return nearest_piece(self.pieces, lows, highs, x, z)
