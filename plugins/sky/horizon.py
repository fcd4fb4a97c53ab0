"""Sky without a network: bright or blue, smooth, connected to the top of the image, and not near."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from bench.contracts.sky import SkySegmenter
from bench.errors import BenchError, require_between
from bench.registry import PluginConfig, register
from bench.types import DepthMap, Image, Map, Mask, StereoCamera

# The search runs on an image of about this width: noise and small clouds get smooth, and it has 16 times fewer pixels.
_WORKING_WIDTH = 320
# Windows in working pixels: the sky's colour around a place, stereo's opinion around a place, the edge to sharpen.
_COLOR_WINDOW = (61, 61)
_NEAR_WINDOW = (7, 7)
_SEAM_WINDOW = (5, 5)
# A sky with at least this share of blue is a blue sky, in which no part is without any blue.
_BLUE_SKY = 0.2
# How bright a part of the sky is at least, relative to the brightest part.
_DARKEST_PART = 0.6
# A blue sky may be darker than a grey one by this factor.
_BLUE_LUMA = 0.75
# How bright the sky may be relative to the sky around.
_BRIGHTEST = 1.25


@dataclass(frozen=True)
class HorizonConfig(PluginConfig):
    """What counts as bright, blue, smooth and near."""

    min_luma: float = 110.0
    """Least brightness of a grey or white sky, in grey levels."""
    min_blue: float = 0.30
    """Least (blue - red) / brightest of a blue sky."""
    max_step: float = 20.0
    """Largest change between neighbours where the search begins, in grey levels."""
    max_disparity: float = 3.0
    """In pixels: what is nearer is no sky (but for blue sky, in which stereo matches wrongly) ..."""
    max_near: float = 0.5
    """... where more than this share of the pixels around is near."""
    min_relative: float = 0.88
    """Least brightness of a pixel relative to the sky around it."""
    max_tint: float = 45.0
    """Largest difference of its tint from that of the sky around it, in grey levels."""

    def __post_init__(self) -> None:
        if self.max_disparity <= 0:
            raise BenchError(f"sky.max_disparity={self.max_disparity} must be positive, for example 3.")
        require_between("sky", self, 0, 255, "min_luma", "max_step", "max_tint")
        require_between("sky", self, 0, 1, "min_blue", "max_near", "min_relative")


@register("sky", "horizon", config=HorizonConfig)
class Horizon(SkySegmenter):
    """Sky by brightness, colour, smoothness and stereo; needs no weights."""

    def __init__(self, config: HorizonConfig) -> None:
        self._config = config

    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> Mask:
        """Boolean (H, W), True = sky; unknown depth says nothing."""
        height, width = image.shape[:2]
        scale = max(1, round(width / _WORKING_WIDTH))
        size = (-(-width // scale), -(-height // scale))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        luma, tint = _luma_and_tint(small)
        blue = (tint > self._config.min_blue * small.max(axis=2)) & (luma > _BLUE_LUMA * self._config.min_luma)
        near = self._near(depth.depth, camera, size) & ~blue
        seeds = _reaching_top(self._smooth_and_bright(luma, blue) & ~near, luma, blue)
        if not seeds.any():
            return np.zeros((height, width), dtype=bool)
        # The sky goes on where its colour does, also between branches.
        luma_around, tint_around = _mean_around(luma, seeds), _mean_around(tint, seeds)
        like = (luma > luma_around * self._config.min_relative) & (np.abs(tint - tint_around) < self._config.max_tint)
        sky = _holding((like & ~near) | seeds, seeds)
        return self._sharpen(image, luma_around, sky)

    def _smooth_and_bright(self, luma: Map, blue: Mask) -> Mask:
        otsu, _ = cv2.threshold(luma.astype(np.uint8), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        kernel = np.ones((3, 3), dtype=np.uint8)
        step = cv2.dilate(luma, kernel) - cv2.erode(luma, kernel)
        bright = luma > max(otsu, self._config.min_luma)
        return (bright | blue) & (step < self._config.max_step)

    def _near(self, depth: Map, camera: StereoCamera, size: tuple[int, int]) -> Mask:
        """Where too many of the pixels around are too near for sky; unknown ones count as far."""
        limit = camera.fx * camera.baseline / self._config.max_disparity
        near = cv2.resize((depth < limit).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return cv2.blur(near, _NEAR_WINDOW) > self._config.max_near

    def _sharpen(self, image: Image, luma_around: Map, sky: Mask) -> Mask:
        """The mask at full size: all of its inside, and in a seam along its edge what looks like the sky around."""
        height, width = image.shape[:2]
        inside = cv2.erode(sky.astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
        seam = cv2.dilate(sky.astype(np.uint8), np.ones(_SEAM_WINDOW, dtype=np.uint8)) > inside
        low = np.where(seam, luma_around * np.float32(self._config.min_relative), np.float32(256.0))
        # Something white before a blue sky is brighter than the sky.
        high = np.where(seam, luma_around * np.float32(_BRIGHTEST), np.float32(256.0))
        low[inside > 0] = 0.0
        low = cv2.resize(low, (width, height), interpolation=cv2.INTER_NEAREST)
        high = cv2.resize(high, (width, height), interpolation=cv2.INTER_NEAREST)
        luma = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        return (luma >= low) & (luma <= high)


def _luma_and_tint(small: Map) -> tuple[Map, Map]:
    """Brightness, and blue minus red, (h, w) float32 in grey levels."""
    luma = np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), dtype=np.float32)
    return luma, small[..., 2] - small[..., 0]


def _mean_around(values: Map, where: Mask) -> Map:
    """Mean of ``values`` over the pixels ``where`` in the window around each place, or of all if it has none."""
    weight = cv2.blur(where.astype(np.float32), _COLOR_WINDOW)
    total = cv2.blur(np.where(where, values, np.float32(0.0)), _COLOR_WINDOW)
    return np.where(weight > 1e-4, total / np.maximum(weight, np.float32(1e-4)), values[where].mean())


def _reaching_top(mask: Mask, luma: Map, blue: Mask) -> Mask:
    """The connected parts of ``mask`` that reach one of the two topmost rows.

    In a blue sky those without any blue are left out, and so are parts much darker than the brightest: walls in the
    shade are bluish.
    """
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    keep = np.zeros(count, dtype=bool)
    keep[labels[:2]] = True
    keep[0] = False
    pixels = np.maximum(np.bincount(labels.ravel(), minlength=count), 1)
    blue_pixels = np.bincount(labels.ravel(), weights=blue.ravel(), minlength=count)
    mean_luma = np.bincount(labels.ravel(), weights=luma.ravel(), minlength=count) / pixels
    if blue_pixels[keep].sum() > _BLUE_SKY * pixels[keep].sum():
        keep &= blue_pixels > 0
    if keep.any():
        keep &= mean_luma > _DARKEST_PART * mean_luma[keep].max()
    return keep[labels]


def _holding(mask: Mask, seeds: Mask) -> Mask:
    """The connected parts of ``mask`` that hold some of the ``seeds``."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    keep = np.zeros(labels.max() + 1, dtype=bool)
    keep[labels[seeds]] = True
    keep[0] = False
    return keep[labels]
