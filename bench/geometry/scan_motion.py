"""Undoing the motion of the car during one turn of a spinning LiDAR."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.geometry import se3
from bench.types import Float


def compensate_motion(points: Float | npt.NDArray[np.float32], T_now_before: Float) -> Float:
    """Points (N, 3) float64 in metres where the LiDAR would see them if it stood still as it faces ahead.

    ``points`` are given in the LiDAR's frame (x ahead, y left, z up) of the moment at which each was measured;
    ``T_now_before`` (4, 4) is the LiDAR one turn earlier seen from now, taken to be an even motion. The LiDAR turns
    clockwise seen from above: what is on the left it measured before it faced ahead, by the fraction azimuth / 2 pi of
    a turn, what is on the right after. Source: the "curl" step of the data set KITTI-360 (Liao et al., PAMI 2022).
    """
    points = np.asarray(points, dtype=np.float64)
    fraction = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi)
    turn, shift = se3.so3_log(T_now_before[:3, :3]), T_now_before[:3, 3]
    moved = points + fraction[:, None] * shift
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return moved
    # Rodrigues' formula R p - p = sin(a) k x p + (1 - cos(a)) k x (k x p), for an angle a of each point's own.
    K = se3.skew(turn / angle)
    once = points @ K.T
    angles = angle * fraction[:, None]
    return np.asarray(moved + np.sin(angles) * once + (1.0 - np.cos(angles)) * (once @ K.T))
