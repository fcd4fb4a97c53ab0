"""The way back when prediction fails: all descriptors against all, then PnP with RANSAC."""

from __future__ import annotations

import cv2
import numpy as np

from bench.tracking.descriptors import Descriptors, Ints, metric_of
from bench.types import Float, StereoCamera

_MAX_DISTANCE = 60
# Tuned on jumps of 5 m along a street: keypoints of the coarse octaves scatter by pixels, and two thirds of the
# matches are wrong.
_REPROJECTION_PX = 5.0
_RANSAC_ITERATIONS = 1000
_MIN_CONSENSUS = 15


def match_descriptors(a: Descriptors, b: Descriptors, ratio: float) -> tuple[Ints, Ints]:
    """Indices (M,), (M,) of descriptors (A, W) and (B, W) that are each other's nearest and pass Lowe's test."""
    if len(a) < 2 or len(b) < 2:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    metric = metric_of(a)
    (best, second), nearest = (part.T for part in metric.nearest(a, b, 2))
    back = metric.nearest(b, a, 1)[1][nearest[0], 0]
    good = (best <= _MAX_DISTANCE) & (best < ratio * second) & (back == np.arange(len(a)))
    return np.flatnonzero(good), nearest[0, good]


def pose_by_pnp(camera: StereoCamera, points: Float, uv: Float) -> Float | None:
    """T_cam_world (4, 4) from world points (M, 3) and pixels (M, 2), outliers allowed; None without consensus.

    OpenCV's RANSAC starts from a fixed seed on every call, so the result is the same every time.
    """
    if len(points) < _MIN_CONSENSUS:
        return None
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        points,
        uv,
        camera.intrinsics,
        None,
        iterationsCount=_RANSAC_ITERATIONS,
        reprojectionError=_REPROJECTION_PX,
        confidence=0.999,
        flags=cv2.SOLVEPNP_P3P,
    )
    if not found or inliers is None or len(inliers) < _MIN_CONSENSUS:
        return None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(rotation)[0]
    T[:3, 3] = translation[:, 0]
    return T if np.isfinite(T).all() else None
