"""Contract of a sky segmenter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from bench.types import DepthMap, Image, Mask, StereoCamera


class SkySegmenter(ABC):
    """Finds the sky, so that it gets no seeds from stereo and no depth supervision (paper, Sec. "Sky Segmentation")."""

    worth_caching: bool = False
    """Whether segmenting takes so long that masks are kept on disk; networks say True."""

    @abstractmethod
    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> Mask | None:
        """Boolean (H, W), True = sky; or None from a segmenter that does nothing. ``depth`` may change the answer."""

    def weights(self) -> dict[str, Path]:
        """The files of network weights in use, by what they are for."""
        return {}
