"""Two distorted cameras made one rectified pair: rotations, common camera, maps from rectified to stored pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from bench.errors import BenchError
from bench.geometry import se3
from bench.types import Float, Image, Map, StereoCamera

_COEFFICIENTS = {"radtan": (4, 5, 8, 12, 14), "equidistant": (4,)}
"""Of each model of distortion: how many numbers OpenCV takes."""
MODELS = tuple(_COEFFICIENTS)
"""``radtan``: k1, k2, p1, p2, then k3, and k4, k5, k6 of the rational model. ``equidistant`` (fisheye): k1 to k4."""
_LARGEST_TURN_DEG = 30.0
"""No stereo rig has cameras that must be turned farther to look the same way, abreast of each other."""


@dataclass(frozen=True)
class DistortedCamera:
    """A camera as it took its images: size and intrinsics in pixels (pixel centres at integers), distortion by OpenCV's
    ``model``. ``where`` names its calibration in messages. Raises ``BenchError`` for numbers that are no camera."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: str
    distortion: tuple[float, ...]
    where: str

    def __post_init__(self) -> None:
        if self.model not in _COEFFICIENTS:
            raise BenchError(f"{self.where}: the distortion model {self.model!r} is none of {', '.join(MODELS)}.")
        counts = _COEFFICIENTS[self.model]
        if len(self.distortion) not in counts:
            raise BenchError(
                f"{self.where}: {len(self.distortion)} distortion coefficients; the model {self.model} has "
                f"{' or '.join(map(str, counts))}. Restore the file."
            )
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        inside = 0 < self.cx < self.width and 0 < self.cy < self.height
        if not (np.isfinite(numbers).all() and min(self.fx, self.fy) > 0 and inside):
            raise BenchError(
                f"{self.where}: fx, fy, cx, cy = {self.fx:g}, {self.fy:g}, {self.cx:g}, {self.cy:g} is no camera of "
                f"{self.width}x{self.height} pixels. Give the calibration of these images."
            )

    @property
    def intrinsics(self) -> Float:
        """The 3x3 matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def maps(self, R_rect_cam: Float, rectified: StereoCamera) -> tuple[Map, Map]:
        """Column and row, (H, W) each, of this camera's images at which each pixel of the rectified one is seen."""
        init = cv2.initUndistortRectifyMap if self.model == "radtan" else cv2.fisheye.initUndistortRectifyMap
        size = (rectified.width, rectified.height)
        maps = init(self.intrinsics, np.array(self.distortion), R_rect_cam, rectified.intrinsics, size, cv2.CV_32FC1)
        return np.asarray(maps[0], np.float32), np.asarray(maps[1], np.float32)


class Rectification:
    """Makes rectified pairs of the images of two distorted cameras.

    ``camera`` is the rectified pair; ``R_rect_left`` (3, 3) turns the axes of the left camera to those of the rectified
    one, so that ``T_world_rect = T_world_left [R_rect_left^T | 0]``. ``maps`` are those of the two cameras, as
    ``DistortedCamera.maps``.
    """

    def __init__(
        self,
        left: DistortedCamera,
        right: DistortedCamera,
        T_right_left: Float,
        focal: float | None = None,
        crop: Sequence[int] | None = None,
    ) -> None:
        """``T_right_left`` (4, 4) in metres takes points from the left camera's axes to the right one's.

        ``focal`` in pixels is that of the rectified images, which have the size of the stored ones. None: as OpenCV
        chooses it for no pixel inside the border to be black; of a fisheye, the stored images' in their middle, because
        all that it sees would make that middle small. ``crop`` is the part that is kept of the rectified images: column
        and row of its first pixel, width, height. Raises ``BenchError`` where these are no left and right camera.
        """
        if (left.width, left.height) != (right.width, right.height):
            raise BenchError(
                f"{left.where} is for {left.width}x{left.height} pixels, and {right.where} for "
                f"{right.width}x{right.height}. Give both cameras images of one size."
            )
        size = (left.width, left.height)
        both_radtan = left.model == right.model == "radtan"
        distortions = [np.array(each.distortion) if both_radtan else np.zeros(4) for each in (left, right)]
        # Which way the cameras must be turned depends on T_right_left alone, for every model of distortion.
        R_left, R_right, P_left, P_right = cv2.stereoRectify(
            left.intrinsics,
            distortions[0],
            right.intrinsics,
            distortions[1],
            size,
            np.ascontiguousarray(T_right_left[:3, :3]),
            np.ascontiguousarray(T_right_left[:3, 3:]),
            flags=cv2.CALIB_ZERO_DISPARITY,
            alpha=0 if both_radtan else -1,
        )[:4]
        turns = np.asarray(R_left, np.float64), np.asarray(R_right, np.float64)
        self.R_rect_left = turns[0]
        _require_abreast(left, right, np.asarray(P_right, np.float64), turns)
        f = float(P_left[0, 0]) if both_radtan else min(left.fx, left.fy, right.fx, right.fy)
        baseline = float(-P_right[0, 3] / P_right[0, 0])
        f = f if focal is None else focal
        cx, cy = float(P_left[0, 2]), float(P_left[1, 2])
        x, y, width, height = (0, 0, *size) if crop is None else crop
        self.camera = StereoCamera(width, height, f, f, cx - x, cy - y, right_position=(baseline, 0.0, 0.0))
        self.maps = left.maps(turns[0], self.camera), right.maps(turns[1], self.camera)

    def pair(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Rectified images (H, W, 3) of the stored ones; what a camera did not see is black."""
        x, y = (
            np.asarray(cv2.remap(image, *maps, interpolation=cv2.INTER_LINEAR), np.uint8)
            for image, maps in zip((left, right), self.maps, strict=True)
        )
        return x, y


def _require_abreast(left: DistortedCamera, right: DistortedCamera, P_right: Float, turns: Sequence[Float]) -> None:
    """Raise ``BenchError`` unless the cameras look the same way and the right one is on the left one's right."""
    pair = f"{left.where} and {right.where}"
    if P_right[1, 3] != 0:
        raise BenchError(f"{pair}: one camera is above the other, not beside it. Turn the images by a quarter first.")
    if not (np.isfinite(P_right).all() and P_right[0, 3] < 0):
        raise BenchError(f"{pair}: the right camera lies on the left one's left. Exchange the two cameras.")
    turn = max(float(np.degrees(se3.rotation_angle(R))) for R in turns)
    if turn > _LARGEST_TURN_DEG:
        raise BenchError(
            f"{pair}: a camera must be turned by {turn:.0f} degrees to look the same way as the other, abreast of it. "
            "Is the transform between the cameras the inverse of what is meant, or are the images rotated?"
        )
