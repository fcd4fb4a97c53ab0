"""LiDAR returns that the camera can't see: the scanner sits higher and looks over edges."""

from __future__ import annotations

import cv2
import numpy as np

from bench.types import Map, Mask

WINDOW_PX = 7
NEARER_BY = 0.1


def unoccluded(lidar: Map) -> Mask:
    """Where ``lidar`` (H, W; metres, NaN = no return) has a return with none nearer by over 10 % in its 7x7 pixels.

    Seen from the camera, returns from behind an edge lie between those of the surface in front; they are no depth of
    the image. Not Depth-L1's default, since it drops some true returns at edges too.
    """
    known = np.isfinite(lidar)
    depth = np.where(known, lidar, np.float32(np.inf)).astype(np.float32)
    nearest = cv2.erode(depth, np.ones((WINDOW_PX, WINDOW_PX), np.uint8))
    return np.asarray(known & (nearest >= np.float32(1.0 - NEARER_BY) * depth))
