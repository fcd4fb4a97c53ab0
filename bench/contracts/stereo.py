"""Contract of a stereo backbone: where the depth that supervises the map comes from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.types import DepthMap, Image, Map, StereoCamera, StereoFrame

_INSTEAD = "a stereo plugin that takes depth from the data set, such as stereo=sensor or stereo=lidar"


class DepthSource(ABC):
    """Gives the depth of a frame's left image. Most authors subclass ``StereoBackbone`` below, and those who bring a
    network ``bench.stereo.torch_network.TorchStereo``."""

    worth_caching: bool = False
    """Whether one frame costs more than reading its depth from disk: True for networks."""
    temporal: bool = False
    """Whether a frame's depth depends on the frames before it; such depth is never taken from the cache."""

    def weights(self) -> dict[str, Path]:
        """Files of weights in use, by what they are for: they are part of a run's provenance and of the cache's key."""
        return {}

    def start(self, dataset: Dataset) -> None:  # noqa: B027 - most sources have nothing to do here
        """Called once before the first frame of a sequence; reset state that is carried from frame to frame here."""

    @abstractmethod
    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """Depth of ``frame.left`` in metres, NaN where unknown. ``position`` is the frame's place in the data set."""


class Matched(NamedTuple):
    """Disparity of the left image in pixels, (H, W) float32, NaN where unknown, and the confidence in it, (H, W)
    float32 from 0 to 1, or None."""

    disparity: Map
    confidence: Map | None = None


class StereoBackbone(DepthSource):
    """A network or matcher that turns a rectified pair into disparity. An author writes ``disparity`` alone."""

    def start(self, dataset: Dataset) -> None:
        """Raises ``BenchError`` for a data set without right images."""
        dataset.require_right(f"stereo backbone {type(self).__name__}", _INSTEAD)

    @abstractmethod
    def disparity(self, left: Image, right: Image) -> Map:
        """Disparity of the left image in pixels, (H, W) float32, positive, NaN where unknown."""

    def matched(self, left: Image, right: Image) -> Matched:
        """``disparity`` with the confidence in it; one that has a confidence writes this one too."""
        return Matched(self.disparity(left, right))

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """Depth by triangulation, f b / d (paper, Sec. "Deep Stereo Depth Estimation").

        Unknown (NaN) where the disparity is not a positive finite number. A frame whose disparity is unknown everywhere
        is a frame without depth; one that has disparities, but none above zero, is an error (``BenchError``).
        """
        disparity, confidence = self.matched(*frame.pair(f"stereo backbone {type(self).__name__}", _INSTEAD))
        try:
            check_disparity(disparity, frame.left.shape[:2], f"{type(self).__name__}.disparity")
            check_sign(disparity, f"{type(self).__name__}.disparity")
        except BenchError as error:
            raise BenchError(f"Frame {frame.number}: {error}") from error
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.float32(camera.fx * camera.baseline) / disparity
        # Also drops an infinite disparity, whose depth would be zero.
        depth[~((depth > 0) & np.isfinite(depth))] = np.nan
        return DepthMap(depth, type(self).__name__, confidence)


def check_disparity(disparity: Map, shape: tuple[int, ...], what: str) -> None:
    """Raise ``BenchError`` unless ``disparity`` is a float32 array of ``shape``.

    ``what`` names the method that returned it, for example ``"MyNet.disparity"``.
    """
    if not isinstance(disparity, np.ndarray):
        raise BenchError(f"{what} returned {type(disparity).__name__}; return a float32 numpy array of shape {shape}.")
    if disparity.shape != shape:
        hint = shape_hint(disparity.shape, shape)
        raise BenchError(
            f"{what} returned an array of shape {disparity.shape}; expected {shape}, the image's height and width"
            f"{hint and ': '}{hint}."
        )
    if disparity.dtype != np.float32:
        raise BenchError(f"{what} returned dtype {disparity.dtype}; expected float32 (add .astype(np.float32)).")


def shape_hint(shape: tuple[int, ...], expected: tuple[int, ...]) -> str:
    """What a map of another shape than (H, W) probably is, and how to mend it; empty where nothing is likely."""
    if len(shape) != 2 or shape == expected:
        return ""
    if shape == expected[::-1]:
        return "height and width are exchanged, transpose it"
    for factor in (2, 4, 8, 16, 32):
        # A network that pads its input to a multiple may give a cell or two more.
        if all(0 <= side - full // factor <= 64 / factor for side, full in zip(shape, expected, strict=True)):
            return (
                f"it is at 1/{factor} of the size, resize it to the image's size and multiply by {factor} "
                "(bench.stereo.resizing.resize_disparity does both)"
            )
    return ""


def check_sign(disparity: Map, what: str, cure: str = "return -d") -> None:
    """Raise ``BenchError`` where a map has disparities, but none above zero; all NaN passes. ``cure``: of the sign."""
    # NaN compares as false, so the first test also fails where nothing is known: only then is it worth a second look.
    if not (disparity > 0).any() and np.isfinite(disparity).any():
        finite = disparity[np.isfinite(disparity)]
        if not finite.any():
            raise BenchError(
                f"{what} returned no disparity above zero, only 0. Return NaN where nothing is known, np.where(d > 0, "
                "d, np.nan); of a pair of different images: are the weights loaded?"
            )
        raise BenchError(
            f"{what} returned no disparity above zero (they reach from {finite.min():.4g} to {finite.max():.4g} px). "
            f"Is its sign wrong ({cure}), or are left and right exchanged? The left pixel x matches the right "
            "pixel x - d, d > 0."
        )
