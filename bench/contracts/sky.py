"""Contract of a sky segmenter."""

from __future__ import annotations

from abc import ABC, abstractmethod

from bench.types import DepthMap, Image, Mask, StereoCamera


class SkySegmenter(ABC):
    """Finds the sky, so that it gets no seeds from stereo and no depth supervision (paper, Sec. "Sky Segmentation")."""

    @abstractmethod
    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> Mask | None:
        """Boolean (H, W), True = sky; or None from a segmenter that does nothing."""
