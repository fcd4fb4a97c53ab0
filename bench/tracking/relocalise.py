"""The way back when prediction fails: all descriptors against all, then PnP with RANSAC."""

from __future__ import annotations

import cv2
import numpy as np

from bench.tracking.features import Descriptors, Ints
from bench.types import Float, StereoCamera

_MAX_HAMMING = 60
# Tuned on jumps of 5 m along a street: keypoints of the coarse octaves scatter by pixels, and two thirds of the
# matches are wrong.
_REPROJECTION_PX = 5.0
_RANSAC_ITERATIONS = 1000
_MIN_CONSENSUS = 15


def match_descriptors(a: Descriptors, b: Descriptors, ratio: float) -> tuple[Ints, Ints]:
    """Indices (M,), (M,) of descriptors (A, 4) and (B, 4) that are each other's nearest and pass Lowe's test."""
    if len(a) < 2 or len(b) < 2:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    forward = matcher.knnMatch(a.view(np.uint8), b.view(np.uint8), k=2)
    nearest = np.array([(m.trainIdx, m.distance, n.distance) for m, n in forward])
    backward = np.array([m.trainIdx for m in matcher.match(b.view(np.uint8), a.view(np.uint8))])
    index = nearest[:, 0].astype(np.int64)
    good = (nearest[:, 1] <= _MAX_HAMMING) & (nearest[:, 1] < ratio * nearest[:, 2])
    good &= backward[index] == np.arange(len(a))
    row = np.flatnonzero(good)
    return row, index[row]


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
