"""The camera's motion between two frames, from the depth of the first: what a temporal network has to be told before
it sees the second, when no tracker has."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from bench.io.images import grey
from bench.types import Float, Image, Map, StereoCamera

_CORNERS = 600
_CORNER_QUALITY = 0.005
_CORNER_DISTANCE_PX = 10
_WINDOW = (21, 21)
_PYRAMID_LEVELS = 4
_BACK_AND_FORTH_PX = 1.0
_REPROJECTION_PX = 2.0
_RANSAC_ROUNDS = 200
_LEAST_INLIERS = 30
_LEAST_INLIER_SHARE = 0.4
"""Fewer of the tracked corners than this moved rigidly: the scene has changed, or the frames are too far apart."""


def motion_between(before: Image, depth_before: Map, now: Image, camera: StereoCamera) -> Float | None:
    """``T_now_before`` (4, 4): takes points of the left camera's frame at ``before`` into that at ``now``, in metres.

    Corners of known depth (H, W; metres, NaN where unknown) are tracked into the image ``now`` (Lucas and Kanade 1981,
    in a pyramid, forth and back) and resected: EPnP in RANSAC, then least squares over those that agree. None when too
    few of them agree on one rigid motion. The same input gives the same bits: OpenCV's RANSAC has a fixed seed.
    """
    grey_before, grey_now = grey(before), grey(now)
    corners = _corners(grey_before, depth_before)
    if len(corners) < _LEAST_INLIERS:
        return None
    there, kept = _tracked(grey_before, grey_now, corners)
    corners, there = corners[kept], there[kept]
    if len(corners) < _LEAST_INLIERS:
        return None
    points, pixels = _points(corners, depth_before, camera), there.astype(np.float64)
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        points,
        pixels,
        camera.intrinsics,
        None,
        iterationsCount=_RANSAC_ROUNDS,
        reprojectionError=_REPROJECTION_PX,
        flags=cv2.SOLVEPNP_EPNP,
    )
    if not found or inliers is None or len(inliers) < max(_LEAST_INLIERS, _LEAST_INLIER_SHARE * len(corners)):
        return None
    # EPnP alone is several times less accurate: 5 cm for 1 cm between two frames of KITTI 06.
    agree = inliers[:, 0]
    rotation, translation = cv2.solvePnPRefineLM(
        points[agree], pixels[agree], camera.intrinsics, None, rotation, translation
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    return T


def size_of(T: Float) -> tuple[float, float]:
    """Length in metres and angle in degrees of a rigid motion (4, 4)."""
    cosine = np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1)
    return float(np.linalg.norm(T[:3, 3])), float(np.degrees(np.arccos(cosine)))


def _corners(grey: npt.NDArray[np.uint8], depth: Map) -> npt.NDArray[np.float32]:
    """Corners (N, 2) where the depth is known, strongest first."""
    known = np.isfinite(depth).astype(np.uint8)
    found = cv2.goodFeaturesToTrack(grey, _CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE_PX, mask=known)
    return np.empty((0, 2), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 2)


def _tracked(
    before: npt.NDArray[np.uint8], now: npt.NDArray[np.uint8], corners: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Where the corners are in ``now`` (N, 2), and for which of them tracking back leads home (N,)."""
    there, found = _follow(before, now, corners)
    back, found_back = _follow(now, before, there)
    home = np.linalg.norm(back - corners, axis=1) < _BACK_AND_FORTH_PX
    return there, home & found & found_back


def _follow(
    first: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8], places: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    guess = places.copy()
    there, status, _ = cv2.calcOpticalFlowPyrLK(first, second, places, guess, winSize=_WINDOW, maxLevel=_PYRAMID_LEVELS)
    return np.asarray(there, np.float32), np.asarray(status)[:, 0] == 1


def _points(pixels: npt.NDArray[np.float32], depth: Map, camera: StereoCamera) -> Float:
    """Points (N, 3) in the camera's frame, at the depth of the pixel that each place is nearest to."""
    columns, rows = np.rint(pixels).astype(int).T
    z = depth[np.clip(rows, 0, depth.shape[0] - 1), np.clip(columns, 0, depth.shape[1] - 1)].astype(np.float64)
    rays = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    return np.column_stack([rays * z[:, None], z])
