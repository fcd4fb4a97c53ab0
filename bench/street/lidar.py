"""A simulated 64-beam LiDAR on the roof, like the HDL-64E of KITTI's car."""

from __future__ import annotations

import cv2
import numpy as np

from bench.geometry.lidar import project_to_depth
from bench.street.casting import RayGrid, cast
from bench.street.surfaces import Surfaces
from bench.types import Float, Map, StereoCamera

BEAMS = 64
_ELEVATIONS = np.deg2rad(np.linspace(2.0, -24.8, BEAMS))
_AZIMUTH_STEP = np.deg2rad(0.17)
_MARGIN = np.deg2rad(8.0)
_MAX_RANGE_M = 80.0
# Where the sensor is in the left camera's frame: above it and a little behind.
_POSITION_M = (0.0, -0.3, -0.27)
# A return is hidden from the camera if everything around its pixel is nearer by this factor.
_HIDDEN = 1.02


def lidar_points(camera: StereoCamera, T_world_cam: Float, surfaces: Surfaces) -> Float:
    """Returns (N, 3) float64 of the beams ahead, in metres in the left camera's frame; within 80 m."""
    T_cam_lidar = np.eye(4)
    T_cam_lidar[:3, 3] = _POSITION_M
    half = np.arctan(max(camera.cx, camera.width - camera.cx) / camera.fx) + _MARGIN
    azimuths = np.arange(-half, half, _AZIMUTH_STEP)
    columns = np.stack([np.sin(azimuths), np.zeros_like(azimuths), np.cos(azimuths)], axis=1)
    rows = np.stack([np.zeros(BEAMS), -np.tan(_ELEVATIONS), np.zeros(BEAMS)], axis=1)
    hits = cast(RayGrid(T_world_cam @ T_cam_lidar, columns, rows, planar_rows=False), surfaces)
    beam, column = np.nonzero(hits.inverse_range > 0)
    directions = rows[beam] + columns[column]
    points = directions / hits.inverse_range[beam, column].astype(np.float64)[:, None]
    return points[np.linalg.norm(points, axis=1) <= _MAX_RANGE_M] + np.array(_POSITION_M)


def lidar_depth(camera: StereoCamera, points: Float, exact_depth: Map) -> Map:
    """Depth (H, W) float32 in metres at the pixels that see a return, NaN elsewhere.

    A return that the camera can't see, because something nearer hides it, is left out. The value is the exact depth at
    the centre of the pixel, so that no rounding to pixels remains in it.
    """
    projected = project_to_depth(points, camera)
    # The farthest surface around the pixel, so that a return at an edge is kept for either side.
    farthest = cv2.dilate(np.nan_to_num(exact_depth, nan=np.inf), np.ones((3, 3), dtype=np.uint8))
    seen = (projected <= farthest * _HIDDEN) & np.isfinite(exact_depth) & (exact_depth <= _MAX_RANGE_M)
    return np.where(seen, exact_depth, np.float32(np.nan)).astype(np.float32)
