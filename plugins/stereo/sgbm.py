"""Semi-global matching (Hirschmueller, PAMI 2008) as OpenCV has it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from bench.contracts.stereo import Matched, StereoBackbone
from bench.errors import BenchError, require_between, require_choice, require_least
from bench.io.images import grey
from bench.registry import PluginConfig, register
from bench.stereo.left_right import left_right_checked
from bench.types import Image, Map

_MODES = {
    "3way": "STEREO_SGBM_MODE_SGBM_3WAY",
    "sgbm": "STEREO_SGBM_MODE_SGBM",
    "hh": "STEREO_SGBM_MODE_HH",
    "hh4": "STEREO_SGBM_MODE_HH4",
}
# OpenCV's disparities are integers in sixteenths of a pixel.
_FRACTIONS = np.float32(16.0)


@dataclass(frozen=True)
class SgbmConfig(PluginConfig):
    """OpenCV's settings, under plainer names."""

    num_disparities: int = 96
    """Disparities searched, from 0; a multiple of 16."""
    block_size: int = 5
    """Side of the matched block in pixels, odd."""
    p1: int = 8
    """Penalty for a disparity step of one pixel, per pixel of the block and channel."""
    p2: int = 32
    """Penalty for a larger step, per pixel of the block and channel."""
    uniqueness: int = 5
    """By how many percent the best cost must beat the second best."""
    speckle_size: int = 200
    """Connected patches of up to so many pixels are dropped; 0: none."""
    speckle_range: int = 1
    """Largest disparity step in pixels within such a patch."""
    lr_max_diff: int = 1
    """By how many pixels the left and the right disparity may differ."""
    mode: str = "3way"
    """Directions that are summed over: 3way, sgbm (5), hh (8) or hh4 (4)."""
    full_check: bool = False
    """Match the right image too, instead of reading its disparities off the left's costs. Measured: twice the time,
    40 % fewer outliers, 5 % fewer pixels."""
    color: bool = False
    """Match colours, not grey values."""

    def __post_init__(self) -> None:
        require_choice("stereo.mode", self.mode, _MODES)
        n = self.num_disparities
        if n < 16 or n % 16:
            raise BenchError(
                f"stereo.num_disparities={n} must be a positive multiple of 16, for example "
                f"{max(16, (n + 15) // 16 * 16)}."
            )
        if self.block_size < 1 or self.block_size % 2 == 0:
            raise BenchError(f"stereo.block_size={self.block_size} must be odd, for example 5.")
        if not 0 < self.p1 < self.p2:
            raise BenchError(
                f"stereo.p1={self.p1} and stereo.p2={self.p2}: 0 < p1 < p2 is needed, for example 8 and 32."
            )
        require_between("stereo", self, 0, 100, "uniqueness")
        require_least("stereo", self, speckle_size=0, speckle_range=0)
        if self.lr_max_diff < 1:
            # OpenCV silently takes 1 for it.
            raise BenchError(f"stereo.lr_max_diff={self.lr_max_diff} must be at least 1 pixel.")


@register("stereo", "sgbm", config=SgbmConfig)
class Sgbm(StereoBackbone):
    """OpenCV semi-global matching: sub-pixel, left-right checked, holes stay unknown."""

    def __init__(self, config: SgbmConfig) -> None:
        channels = 3 if config.color else 1
        area = channels * config.block_size**2
        self._config = config
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=config.num_disparities,
            blockSize=config.block_size,
            P1=config.p1 * area,
            P2=config.p2 * area,
            disp12MaxDiff=config.lr_max_diff,
            preFilterCap=31,
            uniquenessRatio=config.uniqueness,
            speckleWindowSize=config.speckle_size,
            speckleRange=config.speckle_range,
            mode=getattr(cv2, _MODES[config.mode]),
        )

    def disparity(self, left: Image, right: Image) -> Map:
        """Disparity of the left image in pixels, (H, W) float32, NaN where unmatched or inconsistent."""
        return self.matched(left, right).disparity

    def matched(self, left: Image, right: Image) -> Matched:
        """The disparity, and with ``full_check`` the confidence of the left-right check."""
        if not self._config.color:
            left, right = grey(left), grey(right)
        if self._config.full_check:
            return left_right_checked(self._match, left, right, self._config.lr_max_diff)
        return self._match(left, right)

    def _match(self, left: Image, right: Image) -> Matched:
        # OpenCV leaves the first num_disparities columns unknown; the padding takes their place.
        n = self._config.num_disparities
        padded = (cv2.copyMakeBorder(image, 0, 0, n, 0, cv2.BORDER_REPLICATE) for image in (left, right))
        fixed = self._matcher.compute(*padded)[:, n:]
        disparity = fixed.astype(np.float32) / _FRACTIONS
        disparity[fixed <= 0] = np.nan
        return Matched(disparity)
