"""A tracker in a user's folder: each frame is aligned with the render of the map, starting at constant velocity."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench import registry
from bench.contracts.dataset import Dataset
from bench.contracts.map_view import MapView
from bench.contracts.tracker import Tracker
from bench.geometry import se3
from bench.registry import PluginConfig, plugin_field, register
from bench.types import Float, PinholeView, StereoFrame, TrackingResult, Trajectory


@dataclass(frozen=True)
class MapAlignConfig(PluginConfig):
    """How long it looks, with which depth."""

    iterations: int = 40
    rate_m: float = 0.004
    rate_rad: float = 0.0008
    depth_weight: float = 0.3
    stereo: PluginConfig = plugin_field("stereo", "sgbm")


@register("tracker", "map_align", config=MapAlignConfig)
class MapAlign(Tracker):
    """Colour and depth of the map's render against image and stereo, by Adam on the camera's twist."""

    uses_map = True

    def __init__(self, config: MapAlignConfig) -> None:
        self.config, self.stereo = config, registry.build(config.stereo, "stereo")

    def start(self, dataset: Dataset) -> None:
        self.camera, self.poses, self.numbers, self.times = dataset.camera, [np.eye(4)], [], []
        self.stereo.start(dataset)

    def use_map(self, view: MapView) -> None:
        self.map = view

    def track(self, frame: StereoFrame) -> TrackingResult:
        pose = self.poses[-1]
        if self.numbers:
            guess = pose @ se3.inverse(self.poses[-2]) @ pose if len(self.numbers) > 1 else pose
            pose = self.aligned(frame, guess)
        self.poses = [*(self.poses if self.numbers else []), pose]
        self.numbers.append(frame.number)
        self.times.append(frame.timestamp)
        return TrackingResult(pose, "ok")

    def aligned(self, frame: StereoFrame, T_world_cam: Float) -> Float:
        image = torch.from_numpy(frame.left).permute(2, 0, 1).float() / 255
        depth = torch.from_numpy(self.stereo.depth(frame, len(self.numbers), self.camera).depth)

        def loss(color: Tensor, rendered: Tensor, alpha: Tensor) -> Tensor:
            seen = alpha.detach() > 0.95
            known = seen & torch.isfinite(depth) & (depth < 30)
            error = (rendered[known] / alpha[known] - depth[known]).abs() / depth[known]
            return (color - image).abs()[:, seen].mean() + self.config.depth_weight * error.clamp_max(0.1).mean()

        T, first, second = T_world_cam, np.zeros(6), np.zeros(6)
        rates = np.repeat([self.config.rate_m, self.config.rate_rad], 3)
        for k in range(self.config.iterations):
            _, twist = self.map.differentiate(PinholeView.of(self.camera, T), loss)
            first, second = 0.7 * first + 0.3 * twist, 0.9 * second + 0.1 * twist**2
            step = first / (1 - 0.7 ** (k + 1)) / (np.sqrt(second / (1 - 0.9 ** (k + 1))) + 1e-12)
            T = T @ se3.exp(rates * (1 - k / self.config.iterations) * step)
        return T

    def trajectory(self) -> Trajectory:
        poses = np.array(self.poses[: len(self.numbers)]).reshape(-1, 4, 4)
        return Trajectory(poses, np.array(self.numbers, np.int64), np.array(self.times, np.float64))

    def state(self) -> dict[str, Any]:
        poses = torch.from_numpy(np.array(self.poses))
        return {"poses": poses, "numbers": list(self.numbers), "times": list(self.times)}

    def restore(self, state: dict[str, Any]) -> None:
        self.poses, self.numbers, self.times = list(state["poses"].numpy()), state["numbers"], state["times"]
