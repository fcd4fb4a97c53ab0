"""LiDAR points projected into an image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.types import Float, Map, StereoCamera

MIN_DEPTH_M = 0.5


def project_to_depth(
    points: Float | npt.NDArray[np.float32], camera: StereoCamera, min_depth: float = MIN_DEPTH_M
) -> Map:
    """Depth image of points (N, 3) given in the left camera's frame: (H, W) float32 metres, NaN where none falls.

    A point goes to its nearest pixel (pixel centres are integers), the nearest point of a pixel wins, and points with
    z <= ``min_depth`` metres are dropped. Points that are not finite are dropped too.
    """
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    # Only float64 rounds reproducibly at pixel borders; the cheap test on z first halves the work for a full turn.
    front = z > min_depth
    x, y, z = x[front].astype(np.float64), y[front].astype(np.float64), z[front].astype(np.float64)
    u = np.rint(camera.fx * x / z + camera.cx)
    v = np.rint(camera.fy * y / z + camera.cy)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & np.isfinite(z)
    pixel = v[inside].astype(np.int64) * camera.width + u[inside].astype(np.int64)
    depth = np.full(camera.height * camera.width, np.inf, dtype=np.float32)
    np.minimum.at(depth, pixel, z[inside].astype(np.float32))
    depth[np.isinf(depth)] = np.nan
    return depth.reshape(camera.height, camera.width)
