"""Pixels to rays and points to pixels, of a pinhole camera whose pixel centres are at integers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from bench.types import Float, Mask, PinholeView, StereoCamera

Numbers = npt.NDArray[Any]


def directions(u: Numbers, v: Numbers, camera: StereoCamera | PinholeView) -> Float:
    """Rays (N, 3) of pixels at columns ``u`` and rows ``v`` (N,), in the camera's frame: 1 long along its axis."""
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], 1)


def to_world(in_camera: Float, T_world_cam: Float) -> Float:
    """Points (..., 3) of a camera's frame, in the world."""
    return np.asarray(in_camera @ T_world_cam[:3, :3].T + T_world_cam[:3, 3])


def project(points: Float, T_world_cam: Float, camera: StereoCamera | PinholeView) -> tuple[Float, Float, Float]:
    """Columns, rows and depths (N,) of points (N, 3) in the world; behind the camera columns and rows mean nothing."""
    x, y, z = ((points - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z


def inside(u: Float, v: Float, z: Float, camera: StereoCamera | PinholeView, border_px: float) -> Mask:
    """Which points, as ``project`` gives them, lie before the camera and more than ``border_px`` inside its image; a
    negative border is one around it."""
    in_width = (u > border_px) & (u < camera.width - border_px)
    in_height = (v > border_px) & (v < camera.height - border_px)
    return np.asarray(in_width & in_height & (z > 0))
