"""The images of RGB-D data sets: colour, depth of the same pixels, and the camera that took them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.errors import BenchError
from bench.io.images import ImageSequence, nearest_pixels, read_16_bit, require_one_size, shrunk
from bench.types import Image, Map, StereoCamera

_PLAUSIBLE_M = (0.01, 200.0)
"""Depth cameras see neither nearer nor farther; a median outside of it is one of a wrong factor."""


NUMBERS = "dataset.fx=... dataset.fy=... dataset.cx=... dataset.cy=..."
"""What a user types who gives a camera's own."""


@dataclass(frozen=True)
class Intrinsics:
    """Of images as they are stored, in pixels, pixel centres at integers; ``distortion``: k1, k2, p1, p2, k3 (OpenCV),
    or none. ``size`` (width, height) that they are known to hold for, or None."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    size: tuple[int, int] | None = None


def own_or(published: Intrinsics | None, own: Intrinsics, where: str) -> Intrinsics:
    """The user's ``own`` numbers where they are set (above 0), else the ``published`` ones.

    Raises ``BenchError`` where some of the four are set and others not, and where there are none; ``where`` says why.
    """
    given = [name for name in ("fx", "fy", "cx", "cy") if getattr(own, name) > 0]
    if len(given) == 4:
        return own
    if given or published is None:
        have = f"Of dataset.fx, fy, cx, cy only {', '.join(given)} is set" if given else where
        raise BenchError(f"{have}. Give all four, in pixels: {NUMBERS}")
    return published


class RgbdImages:
    """Colour and depth images of the same size; ``camera`` is that of the images as they are handed out.

    ``remarks``: what a user should know of how they were read.
    """

    def __init__(
        self, color: Sequence[Path], depth: Sequence[Path], intrinsics: Intrinsics, factor: float, scale: float
    ) -> None:
        """``depth`` stores metres times ``factor``; ``scale`` (at most 1) is that of the sides handed out.

        Raises ``BenchError`` for a file that is missing or damaged, and where the images differ in size.
        """
        self._color, self._depth, self._factor = color, depth, factor
        self._images = ImageSequence(color, color)
        self._size = self._images.size
        if (of_depth := require_one_size(depth)) != self._size:
            raise BenchError(
                f"The depth image {depth[0]} is {of_depth[0]}x{of_depth[1]} pixels, and the colour image {color[0]} is "
                f"{self._size[0]}x{self._size[1]}: depth must be given for the pixels of the colour image. Register it."
            )
        if intrinsics.size not in (None, self._size):
            raise BenchError(
                f"{color[0]} is {self._size[0]}x{self._size[1]} pixels, and the published camera is of "
                f"{intrinsics.size[0]}x{intrinsics.size[1]}. Give the numbers of this one: {NUMBERS}"
            )
        self._distortion = np.array(intrinsics.distortion)
        fx, fy, cx, cy = astuple(intrinsics)[:4]
        self._K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        self.camera = StereoCamera(*self._size, fx, fy, cx, cy, right_position=(0.0, 0.0, 0.0)).scaled(scale)
        self.remarks = (*self._images.remarks, *self._doubt_about_factor())

    def color(self, position: int) -> Image:
        """RGB uint8 (H, W, 3), straightened where the camera has a distortion."""
        image = self._images.read(self._color[position])
        if self._distortion.any():
            image = np.asarray(cv2.undistort(image, self._K, self._distortion), np.uint8)
        return shrunk(image, self._scaled)

    def depth(self, position: int) -> Map:
        """(H, W) float32 metres as the sensor gave them, NaN where it gave none (0)."""
        stored = read_16_bit(self._depth[position], self._size, "RGB-D data sets store depth")
        stored = nearest_pixels(stored, self._scaled)
        return np.where(stored > 0, stored / np.float32(self._factor), np.float32(np.nan)).astype(np.float32)

    @property
    def _scaled(self) -> tuple[int, int]:
        return self.camera.width, self.camera.height

    def _doubt_about_factor(self) -> list[str]:
        known = self.depth(0)
        known = known[np.isfinite(known)]
        low, high = _PLAUSIBLE_M
        if not len(known) or low <= (median := float(np.median(known))) <= high:
            return []
        return [f"the first frame's median depth is {median:.3g} m: is dataset.depth_factor={self._factor:g} right?"]
