"""Networks for the tests of the cache: they count their calls, on disk too, so that calls in other processes count."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.sky import SkySegmenter
from bench.contracts.stereo import DepthSource
from bench.registry import PluginConfig, register
from bench.types import DepthMap, Image, Mask, StereoCamera, StereoFrame


@dataclass(frozen=True)
class CountingConfig(PluginConfig):
    """``log``: gets a line per call; ``delay_s``: how long computing takes; ``far``: depth of the top row."""

    weights: str = field(default="", metadata={"path": True})
    log: str = ""
    delay_s: float = 0.0
    far: float = 80.0


@register("stereo", "counting_for_tests", config=CountingConfig)
class CountingStereo(DepthSource):
    """Depth from the frame's pixels, with holes, negative zero and all bits of the mantissa in use."""

    worth_caching = True

    def __init__(self, config: CountingConfig) -> None:
        self.config = config

    def weights(self) -> dict[str, Path]:
        return {"network": Path(self.config.weights)} if self.config.weights else {}

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        with open(self.config.log, "a") as log:
            log.write(f"{frame.number}\n")
        time.sleep(self.config.delay_s)
        difference = frame.left.astype(np.float32).sum(axis=2) - frame.right.astype(np.float32).mean(axis=2)
        depth = np.float32(5.0) + np.abs(difference) / np.float32(7.0)
        depth[::3, ::5] = np.nan
        depth[0] = np.float32(self.config.far)
        return DepthMap(depth, "counting")


@register("stereo", "temporal_for_tests", config=CountingConfig)
class TemporalStereo(CountingStereo):
    """The same, said to depend on the frames before."""

    temporal = True


@register("sky", "counting_sky_for_tests", config=CountingConfig)
class CountingSky(SkySegmenter):
    """Sky where the image is bright and depth is unknown or far."""

    worth_caching = True

    def __init__(self, config: CountingConfig) -> None:
        self.config = config

    def segment(self, image: Image, depth: DepthMap, camera: StereoCamera) -> Mask | None:
        with open(self.config.log, "a") as log:
            log.write("sky\n")
        time.sleep(self.config.delay_s)
        return ~(depth.depth < 30) & (image.sum(axis=2) > 300)
