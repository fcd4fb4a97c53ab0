"""No sky segmentation."""

from __future__ import annotations

from bench.contracts.sky import SkySegmenter
from bench.registry import register
from bench.types import DepthMap, Image, StereoCamera


@register("sky", "none")
class NoSky(SkySegmenter):
    """No sky segmentation (the paper's ablation "w/o ss")."""

    def __init__(self, config: object) -> None:
        """``config`` has no settings."""

    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> None:
        """Always None."""
        return None
