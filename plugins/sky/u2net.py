"""Sky by a small U2-Net (Qin et al., Pattern Recognition 2020) trained for sky, limited by stereo."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2

from bench.contracts.sky import SkySegmenter
from bench.errors import BenchError
from bench.registry import PluginConfig, register
from bench.sky.near import NearLimit
from bench.sky.onnx_network import OnnxNetwork, missing_onnxruntime, normalised
from bench.types import DepthMap, Image, Mask, StereoCamera
from bench.weights import missing, resolve

# What the network was trained at, for a file that takes any size.
_SIZE = (384, 384)


@dataclass(frozen=True)
class U2netConfig(PluginConfig):
    """The network takes bright walls for sky, so what stereo finds near is dropped from the mask."""

    weights: str = field(default="", metadata={"path": True})
    """The ONNX file; empty: that of `bgs-bench weights path skyseg_u2netp`."""
    threshold: float = 0.5
    """Smallest probability of sky."""
    min_depth_m: float = 30.0
    """A connected part of the mask is dropped when too much of it is nearer than so many metres; 0: never ..."""
    max_near: float = 0.8
    """... and this is the share of its known depths that is too much."""

    def __post_init__(self) -> None:
        if not 0.0 < self.threshold < 1.0:
            raise BenchError(f"sky.threshold={self.threshold} is no probability between 0 and 1, for example 0.5.")
        NearLimit(self.min_depth_m, self.max_near)  # checks both


@register("sky", "u2net", config=U2netConfig)
class U2net(SkySegmenter):
    """U2-Net for sky, ONNX; stereo removes bright walls that it takes for sky."""

    worth_caching = True

    def __init__(self, config: U2netConfig) -> None:
        self._limit = NearLimit(config.min_depth_m, config.max_near)
        self._threshold = config.threshold
        self._network = OnnxNetwork(Path(config.weights) if config.weights else resolve("skyseg_u2netp"), "sky")

    @staticmethod
    def unavailable_reason() -> str | None:
        """Why networks can't run here, or None."""
        return missing_onnxruntime()

    @staticmethod
    def missing_weights() -> str | None:
        """How to get the network's file, or None."""
        return missing("skyseg_u2netp")

    def weights(self) -> dict[str, Path]:
        """The ONNX file."""
        return {"sky": self._network.path}

    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> Mask:
        """Boolean (H, W), True = sky; unknown depth says nothing."""
        height, width = image.shape[:2]
        probability = self._network.run(normalised(image, self._network.size or _SIZE))
        if probability.shape[0] != 1:
            raise BenchError(
                f"{self._network.path} returns {probability.shape[0]} maps; sky=u2net needs one, the probability of "
                "sky. For a network with classes choose sky=segformer."
            )
        sky = cv2.resize(probability[0], (width, height), interpolation=cv2.INTER_LINEAR) > self._threshold
        return self._limit.applied(sky, depth.depth)
