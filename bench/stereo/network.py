"""Base class of stereo networks, whatever runs them: scale, tiles, left-right check, weights, and the checks of what
comes out."""

from __future__ import annotations

import logging
from abc import abstractmethod
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from bench.contracts.stereo import Matched, StereoBackbone, check_disparity, check_sign
from bench.errors import BenchError
from bench.registry import PluginConfig
from bench.stereo.left_right import left_right_checked
from bench.stereo.resizing import at_scale
from bench.stereo.tiling import tiled
from bench.types import Image, Map, check_confidence
from bench.weights import chosen

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class NetworkConfig(PluginConfig):
    """Settings that every network has; derive the plugin's own config from it."""

    weights: str = field(default="", metadata={"path": True})
    """File of weights; empty: the published ones, from where `bgs-bench weights path` finds them."""
    device: str = "auto"
    """auto, cpu, cuda, cuda:1, ..."""
    dtype: str = "float32"
    """float32, bfloat16 or float16: what the network computes in; the disparity is float32 in any case. Where the
    hardware has instructions for it (GPUs; CPUs with AVX-512 BF16 or AMX) bfloat16 takes about half the time."""
    scale: float = 1.0
    """The network sees images this many times as large; the disparity is in pixels of the full image all the same."""
    tile_rows: int = 0
    """Match in strips of at most this many rows of the image that is fed, to save memory; 0: the image at once."""
    tile_overlap: int = 64
    """How many more rows a strip sees above and below."""
    left_right_check_px: float = 0.0
    """Match the right image too, and drop disparities that differ by more than this many pixels; 0: no check."""

    def __post_init__(self) -> None:
        if not 0.05 <= self.scale <= 4:
            raise BenchError(f"stereo.scale={self.scale} must be between 0.05 and 4; 0.5 is half the size.")
        if self.tile_rows < 0 or self.tile_overlap < 0:
            raise BenchError(
                f"stereo.tile_rows={self.tile_rows} and stereo.tile_overlap={self.tile_overlap} must not be "
                "negative; tile_rows=0 matches the image at once."
            )
        if self.left_right_check_px < 0:
            raise BenchError(
                f"stereo.left_right_check_px={self.left_right_check_px} must be 0 (no check) or a number of pixels."
            )


class StereoNetwork(StereoBackbone):
    """A network; an author who brings one in torch subclasses ``TorchStereo`` and others write ``match``."""

    worth_caching = True

    def __init__(self, config: NetworkConfig, published: str = "") -> None:
        """``published`` is the manifest's name of the weights to use where ``config.weights`` is empty, or "" for a
        network without weights. Raises ``BenchError`` for weights that are not there."""
        self._settings = config
        self._unit_is_told = False
        self.weights_path = chosen("stereo.weights", config.weights, published) if config.weights or published else None

    def weights(self) -> dict[str, Path]:
        """The network's file of weights, if it has one."""
        return {} if self.weights_path is None else {"network": self.weights_path}

    @property
    def sign_cure(self) -> str:
        """What to do about a network whose disparities are all negative."""
        return "return -d"

    @property
    def unit_cure(self) -> str:
        """What to do about disparities that are no pixels."""
        return "Are they coded, normalised to 0 to 1, or depth? Return pixels"

    @abstractmethod
    def match(self, left: Image, right: Image) -> Map | Matched:
        """Disparity (H, W) float32 of the left image, in pixels of the images given here, NaN where unknown; from a
        network that knows how sure it is, ``Matched(disparity, confidence)``.

        The images are what is left to do after scaling and tiling: (H, W, 3) uint8 RGB of any size.
        """

    def disparity(self, left: Image, right: Image) -> Map:
        """The disparity of ``matched``."""
        return self.matched(left, right).disparity

    def matched(self, left: Image, right: Image) -> Matched:
        """Disparity in pixels of the given images, (H, W) float32, NaN where the network has no positive number, or
        where the left-right check fails, and the confidence of either. Raises ``BenchError`` for what no network should
        return."""
        if left.shape != right.shape:
            raise BenchError(
                f"{type(self).__name__}: the left image is {left.shape}, the right one {right.shape}; a rectified pair "
                "has one size."
            )
        settings, matcher = self._settings, self._match_all
        if settings.left_right_check_px:
            # The check sees pixels of the fed image, the setting means those of the full one.
            matcher = partial(left_right_checked, matcher, max_px=settings.left_right_check_px * settings.scale)
        if settings.scale == 1:
            return matcher(left, right)
        return at_scale(matcher, left, right, settings.scale)

    def _match_all(self, left: Image, right: Image) -> Matched:
        """``match`` on the pair or its strips, with the checks of what came out."""
        matcher = self._match_checked
        if self._settings.tile_rows:
            rows, overlap = self._settings.tile_rows, self._settings.tile_overlap
            matcher = partial(tiled, matcher, rows=rows, overlap=overlap)
        disparity, confidence = matcher(left, right)
        check_sign(disparity, f"{type(self).__name__}.match", self.sign_cure)
        known = (disparity > 0) & np.isfinite(disparity)
        if not known.any():
            weights = f", or the weights {self.weights_path} are damaged" if self.weights_path else ""
            dtype = self._settings.dtype
            overflow = f"it overflows in dtype={dtype} (try stereo.dtype=float32)"
            computed = "it divides by zero, or the images are not normalised as in training"
            raise BenchError(
                f"{type(self).__name__} returned no number at all, only NaN: "
                f"{computed if dtype == 'float32' else overflow}{weights}."
            )
        self._check_unit(disparity[known], left.shape[1])
        return Matched(np.where(known, disparity, np.float32(np.nan)), confidence)

    def _check_unit(self, known: Map, width: int) -> None:
        """Warn once of what can't be pixels: the left pixel x < width matches the right pixel x - d, and a street's
        nearest pixels have tens of them (62 px at the bottom of KITTI's images, 3 at a twentieth of their size)."""
        median, largest = float(np.median(known)), float(known.max())
        if self._unit_is_told or (median < width and largest >= 1):
            return
        self._unit_is_told = True
        what, told = (
            type(self).__name__,
            f"the median is {median:.4g}, the largest {largest:.4g}, images are {width} wide",
        )
        log.warning("%s: disparities are no pixels, or depth is wrong: %s. %s", what, told, self.unit_cure)

    def _match_checked(self, left: Image, right: Image) -> Matched:
        answer, what = self.match(left, right), f"{type(self).__name__}.match"
        matched = answer if isinstance(answer, Matched) else Matched(answer)
        check_disparity(matched.disparity, left.shape[:2], what)
        if matched.confidence is not None:
            check_confidence(matched.confidence, left.shape[:2], what)
        return matched
