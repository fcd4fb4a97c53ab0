"""Sky by SegFormer (Xie et al., NeurIPS 2021) or another network with the classes of Cityscapes, limited by stereo.

The published weights may not be passed on, so tests hold the calling convention only: how good the network is on this
path has not been measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from bench.contracts.sky import SkySegmenter
from bench.errors import BenchError
from bench.registry import PluginConfig, register
from bench.sky.near import NearLimit
from bench.sky.onnx_network import OnnxNetwork, missing_onnxruntime, normalised
from bench.sky.transformers_network import CITYSCAPES_SKY, TransformersNetwork
from bench.types import DepthMap, Image, Mask, StereoCamera
from bench.weights import missing, resolve


@dataclass(frozen=True)
class SegformerConfig(PluginConfig):
    """The network, how to feed it, and what stereo drops from its mask."""

    weights: str = field(default="", metadata={"path": True})
    """An ONNX file, or a folder as Hugging Face has it (config.json and the weights), which needs the package
    transformers; empty: that of `bgs-bench weights path segformer_b5`."""
    input_name: str = ""
    """Input of an ONNX file; empty: its only one."""
    output_name: str = ""
    """Output of an ONNX file; empty: its first one."""
    size: tuple[int, int] = (0, 0)
    """[height,width] to feed the image at; [0,0]: what an ONNX file demands, else the image's own."""
    sky_class: int = -1
    """Number of the class sky, 10 in Cityscapes; -1: what a folder's config.json calls sky, else 10."""
    device: str = "auto"
    """Where the network of a folder runs: auto, cpu or cuda."""
    min_depth_m: float = 30.0
    """A connected part of the mask is dropped when too much of it is nearer than so many metres; 0: never ..."""
    max_near: float = 0.8
    """... and this is the share of its known depths that is too much."""

    def __post_init__(self) -> None:
        if min(self.size) < 0 or (0 in self.size and any(self.size)):
            raise BenchError(f"sky.size={list(self.size)} is no size; give [height,width], or [0,0] for the image's.")
        if self.sky_class < -1:
            raise BenchError(f"sky.sky_class={self.sky_class} is no class; give a number, 10 for Cityscapes, or -1.")
        NearLimit(self.min_depth_m, self.max_near)  # checks both


@register("sky", "segformer", config=SegformerConfig)
class Segformer(SkySegmenter):
    """SegFormer with Cityscapes classes, as ONNX file or Hugging Face folder."""

    worth_caching = True

    def __init__(self, config: SegformerConfig) -> None:
        self._limit = NearLimit(config.min_depth_m, config.max_near)
        path = Path(config.weights) if config.weights else resolve("segformer_b5")
        self._network, sky_class = _network(path, config)
        self._size = config.size if any(config.size) else None
        demanded = self._network.size
        if self._size and demanded and self._size != demanded:
            raise BenchError(
                f"sky.size={list(config.size)}: {path} takes {list(demanded)} only. Leave sky.size away, or export the "
                "network for this size."
            )
        self._size = self._size or demanded
        self._sky_class = config.sky_class if config.sky_class >= 0 else sky_class

    @staticmethod
    def missing_weights() -> str | None:
        """How to get the published network, or None."""
        return missing("segformer_b5")

    def weights(self) -> dict[str, Path]:
        """The file with the weights."""
        return {"sky": self._network.path}

    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> Mask:
        """Boolean (H, W), True = sky; unknown depth says nothing."""
        height, width = image.shape[:2]
        logits = self._network.run(normalised(image, self._size or (height, width)))
        if len(logits) <= max(self._sky_class, 1):
            raise BenchError(
                f"{self._network.path} returns {len(logits)} maps, so sky.sky_class={self._sky_class} does not exist. "
                "Give the number of the class sky, or choose sky=u2net for a network that returns one map."
            )
        return self._limit.applied(_is_largest(logits, self._sky_class, (width, height)), depth.depth)


def _network(path: Path, config: SegformerConfig) -> tuple[OnnxNetwork | TransformersNetwork, int]:
    """The network, and the number of its class sky."""
    # The manifest names a file inside the folder.
    folder = path if path.is_dir() else path.parent
    if path.suffix != ".onnx" and (folder / "config.json").is_file():
        network = TransformersNetwork(folder, "sky", config.device)
        return network, network.sky_class
    missing = missing_onnxruntime()
    if missing is not None:
        raise BenchError(f"sky=segformer can't run {path}: {missing}")
    return OnnxNetwork(path, "sky", config.input_name, config.output_name), CITYSCAPES_SKY


def _is_largest(logits: npt.NDArray[np.float32], chosen: int, size: tuple[int, int]) -> Mask:
    """Where the class ``chosen`` wins, at ``size`` = (width, height), after each class (C, h, w) was interpolated."""
    rest = np.full(size[::-1], -np.inf, np.float32)
    for index, plane in enumerate(logits):
        if index != chosen:
            np.maximum(rest, cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR), out=rest)
    largest: Mask = cv2.resize(logits[chosen], size, interpolation=cv2.INTER_LINEAR) > rest
    return largest
