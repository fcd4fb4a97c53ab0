"""Contract of a stereo backbone: where the depth that supervises the map comes from."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.types import DepthMap, Image, Map, StereoCamera, StereoFrame


class DepthSource(ABC):
    """Gives the depth of a frame's left image. Most authors subclass ``StereoBackbone`` below."""

    def start(self, dataset: Dataset) -> None:  # noqa: B027 - most sources have nothing to do here
        """Called once before the first frame of a sequence; reset state that is carried from frame to frame here."""

    @abstractmethod
    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """Depth of ``frame.left`` in metres, NaN where unknown. ``position`` is the frame's place in the data set."""


class StereoBackbone(DepthSource):
    """A network or matcher that turns a rectified pair into disparity. An author writes ``disparity`` alone."""

    @abstractmethod
    def disparity(self, left: Image, right: Image) -> Map:
        """Disparity of the left image in pixels, (H, W) float32, positive, NaN where unknown."""

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """Depth by triangulation, f b / d (paper, Sec. "Deep Stereo Depth Estimation")."""
        disparity = self.disparity(frame.left, frame.right)
        _check(disparity, frame.left, type(self).__name__)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(disparity > 0, camera.fx * camera.baseline / disparity, np.nan)
        return DepthMap(depth.astype(np.float32), type(self).__name__)


def _check(disparity: Map, left: Image, plugin: str) -> None:
    if not isinstance(disparity, np.ndarray) or disparity.shape != left.shape[:2]:
        got = getattr(disparity, "shape", type(disparity).__name__)
        raise BenchError(
            f"{plugin}.disparity returned {got}; expected a float32 array of shape {left.shape[:2]}, the image's size."
        )
    if disparity.dtype != np.float32:
        raise BenchError(f"{plugin}.disparity returned dtype {disparity.dtype}; expected float32.")
