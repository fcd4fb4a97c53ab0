"""SplaTAM's mapping: a Gaussian for each pixel that the map does not show yet, and a new optimizer for each frame."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from bench import registry
from bench.baselines.splatam.densification import gaussians_of, to_add
from bench.baselines.splatam.overlap import overlap_window
from bench.contracts.loss import LossTerm
from bench.contracts.map_view import MapView
from bench.contracts.mapper import MapNeeds, Mapper
from bench.contracts.rasterizer import Gradients, Rasterizer
from bench.errors import BenchError, require_between, require_least
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.gaussians.optimizer import LearningRates, MapOptimizer
from bench.gaussians.schema import LOG_SCALE, OPACITY_LOGIT, SH_C0, planes_of
from bench.registry import PluginConfig, plugin_field, register
from bench.supervision.photometric import Photometric, photometric
from bench.supervision.target import Target, target_of
from bench.types import (
    Event,
    Float,
    Keyframe,
    Map,
    MappingReport,
    PinholeView,
    RenderedView,
    StereoCamera,
    Trajectory,
)

_PRUNE_EVERY, _PRUNE_UNTIL = 20, 20
_PRUNE_OPACITY = 0.005
# Of the depth of the first frame: larger Gaussians go.
_LARGEST_SHARE = 0.1
_DSSIM = 0.2
# Bytes a pixel: image and depth in float32, and where depth is known.
_KEPT_BYTES = 17
# Gaussians that a frame adds for each pixel, and the program with what it imports.
_GROWTH, _PROGRAM_GB = 0.06, 0.45
# A keyframe's pose that the tracker corrects by less leaves the map where it is.
_FOLLOW_M, _FOLLOW_DEG = 0.01, 0.05


@dataclass(frozen=True)
class SplatamMapperConfig(PluginConfig):
    """Settings of the mapper. The defaults are those that SplaTAM's authors have for Replica."""

    isotropic: bool = True
    """Whether Gaussians are balls; false: ellipsoids, which are born as balls."""
    iterations: int = 60
    """Steps a frame; each learns from one view."""
    window: int = 24
    """At most so many frames are learned from: the new one, the last one that is kept, and others that overlap."""
    mean_rate: float = 1e-4
    """Adam's rate of the positions, in metres."""
    color_rate: float = 2.5e-3
    """Adam's rate of the colours, of 0 to 1."""
    rotation_rate: float = 1e-3
    """Adam's rate of the quaternions; balls do not turn."""
    opacity_rate: float = 0.05
    """Adam's rate of the opacities' logits."""
    scale_rate: float = 1e-3
    """Adam's rate of the sizes' logarithms."""
    depth_weight: float = 1.0
    """Weight of the mean depth error, in metres, over the pixels of known depth."""
    color_weight: float = 0.5
    """Weight of the colour error, 0.8 L1 + 0.2 (1 - SSIM) over all pixels."""
    silhouette: float = 0.5
    """Pixels get a Gaussian where the map's alpha is below this."""
    scene_radius_depth_ratio: float = 3.0
    """The scene's radius is the largest depth of the first frame over this; Gaussians above a tenth of it go."""
    max_depth_m: float = field(default=float("inf"), metadata={"infinite": True})
    """Depth counts up to so many metres."""
    rasterizer: PluginConfig = plugin_field("rasterizer", "cpu")
    """Which rasterizer draws the map."""

    def __post_init__(self) -> None:
        require_least("mapper", self, iterations=0, window=2, mean_rate=0, color_rate=0, rotation_rate=0)
        require_least("mapper", self, opacity_rate=0, scale_rate=0, depth_weight=0, color_weight=0)
        require_between("mapper", self, 0, 1, "silhouette")
        for name in ("scene_radius_depth_ratio", "max_depth_m"):
            if not getattr(self, name) > 0:
                raise BenchError(f"mapper.{name}={getattr(self, name)} must be above 0.")


@register("mapper", "splatam", config=SplatamMapperConfig)
class SplatamMapper(Mapper):
    """SplaTAM's mapping (Keetha et al., 2024): Gaussians per pixel, each frame learned from a few that overlap with it.

    Each frame first adds Gaussians of one pixel's size where alpha is low or the depth lies far behind, then takes
    ``iterations`` steps of a new Adam, each on one random view of the new frame, the last of the kept ones and others
    that overlap with it. Kept are the frames that the keyframer's window names, with image and depth in memory for
    ever, 17 bytes a pixel (SplaTAM: 16); of every fifth frame that is 1.5 MB a frame on KITTI. In steps 0 and 20
    Gaussians that are transparent or too large go, and as in SplaTAM, where pruning drops the gradients, these two
    steps change nothing else. The loss terms of the run have no part in it, and sky counts as unknown depth.

    It differs from the original in that one Gaussian may cover up to 0.999 of a pixel (0.99 there), that pixels are
    rendered at integer coordinates (half a pixel beside them there), and that colours below 0 are drawn as 0 and stay
    so. Where a tracker corrects poses, the map follows.
    """

    map_file = "map.ply"

    def __init__(self, config: SplatamMapperConfig) -> None:
        self.config = config
        self._rasterizer: Rasterizer = registry.build(config.rasterizer, "rasterizer")

    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        c = self.config
        self._camera, self._random = camera, np.random.default_rng(seed)
        self._map = GaussianMap(0, self._rasterizer.device)
        self._rates = LearningRates(
            position=c.mean_rate,
            color=c.color_rate / SH_C0,
            opacity=c.opacity_rate,
            scale=c.scale_rate,
            rotation=0.0 if c.isotropic else c.rotation_rate,
        )
        self._kept: dict[int, Target] = {}
        self._largest_m: float | None = None

    def size(self) -> dict[str, int]:
        return {"gaussians": len(self._map)}

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        number = keyframe.frame.number
        self._kept = {kept: target for kept, target in self._kept.items() if kept in window}
        new = self._target(keyframe)
        self._densify(number, new)
        stored = {kept: target.view for kept, target in self._kept.items()}
        chosen = overlap_window(new.view, new.depth.cpu().numpy(), stored, self.config.window, self._random)
        pruned, losses = self._optimise([*(self._kept[each] for each in chosen), new])
        self._kept[number] = new
        planes = self._map.planes
        if not bool(torch.isfinite(planes).all()):
            raise BenchError(
                f"after frame {number}: the map holds Gaussians that are not finite. Lower mapper's rates."
            )
        events = (Event("pruned", number, {"count": pruned}),) if pruned else ()
        return MappingReport(self._psnr(new), losses, events)

    def update_poses(self, trajectory: Trajectory) -> None:
        for number, target in self._kept.items():
            pose = trajectory.pose_of(number)
            if pose is not None and not np.array_equal(pose, target.view.T_world_cam):
                self._kept[number] = self._seen_from(target, pose)
        self._map.follow(trajectory, _FOLLOW_M, _FOLLOW_DEG)

    def finish(self) -> None:
        """Nothing is left to do: all frames are learned from when they come."""

    def state(self) -> dict[str, Any]:
        poses = {number: torch.from_numpy(target.view.T_world_cam.copy()) for number, target in self._kept.items()}
        # The random state has numbers of 128 bits, which a restricted unpickler need not know.
        random = json.dumps(self._random.bit_generator.state)
        return {"map": self._map.state(), "kept": poses, "largest_m": self._largest_m, "random": random}

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        self._map.restore(state["map"])
        found = {k.frame.number: self._target(k) for k in keyframes if k.frame.number in state["kept"]}
        self._kept = {number: self._seen_from(found[number], T.numpy()) for number, T in state["kept"].items()}
        self._largest_m = state["largest_m"]
        self._random.bit_generator.state = json.loads(state["random"])

    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        return self.view().render(view)

    def view(self) -> MapView:
        return GaussianMapView(self._map, self._rasterizer)

    def save(self, path: Path) -> None:
        self._map.save(path)

    def keyframes_of_map(self) -> npt.NDArray[np.int32]:
        return self._map.keyframes_of_all()

    def needs(self, frames: int) -> MapNeeds:
        pixels = self._camera.width * self._camera.height
        gaussians = pixels * (1 + _GROWTH * frames)
        columns = 4 * planes_of(0)
        kept_gb = frames / 5 * pixels * _KEPT_BYTES / 1e9
        return MapNeeds(
            map_bytes=gaussians * (columns + 12),
            checkpoint_bytes=3 * gaussians * columns,
            memory_gb=_PROGRAM_GB + 6 * gaussians * columns / 1e9 + kept_gb,
        )

    def _target(self, keyframe: Keyframe) -> Target:
        view = PinholeView.of(self._camera, keyframe.T_world_cam)
        return target_of(keyframe, view, (0.0, self.config.max_depth_m), self._map.device)

    def _seen_from(self, target: Target, T_world_cam: Float) -> Target:
        return replace(target, view=PinholeView.of(self._camera, T_world_cam))

    def _densify(self, number: int, new: Target) -> None:
        """Add Gaussians for the pixels that need them; the first depth says how large Gaussians may become."""
        if self._largest_m is None and bool(new.depth_mask.any()):
            radius = float(new.depth.max()) / self.config.scene_radius_depth_ratio
            self._largest_m = _LARGEST_SHARE * radius
        rendered = self._rasterizer.render(self._map.planes, new.view, differentiable=False)
        planes = gaussians_of(to_add(rendered, new.depth, self.config.silhouette), new.image, new.depth, new.view)
        # The optimizer multiplies the rate of a position by the depth at birth; here all have the same.
        self._map.add(number, new.view.T_world_cam, planes, torch.ones(planes.shape[1]))

    def _optimise(self, targets: Sequence[Target]) -> tuple[int, dict[str, float]]:
        """The steps of one frame; how many Gaussians were pruned, and the loss terms of the last step."""
        optimizer, pruned = MapOptimizer(self._rates), 0
        self._map.first_moment.zero_()
        self._map.second_moment.zero_()
        losses: dict[str, float] = {}
        for iteration in range(self.config.iterations):
            target = targets[int(self._random.integers(len(targets)))]
            if iteration <= _PRUNE_UNTIL and iteration % _PRUNE_EVERY == 0:
                pruned += self._prune()  # and the step that would follow changes nothing
                continue
            losses, gradients = self._gradients(target)
            optimizer.step(self._map, gradients)
        return pruned, losses

    def _gradients(self, target: Target) -> tuple[dict[str, float], Gradients]:
        """Loss terms of a view and their gradient; dense, since Adam moves on also what the view does not see."""
        c = self.config
        rendered = self._rasterizer.render(self._map.planes, target.view)
        weights = Photometric(l1=c.color_weight * (1 - _DSSIM), dssim=c.color_weight * _DSSIM)
        # A copy, since a target keeps what SSIM needs of it: more than the target itself.
        color, by_color = photometric(rendered.color, replace(target), weights)
        known = max(int(target.depth_mask.sum()), 1)
        error = (rendered.depth - target.depth) * target.depth_mask
        gradients = self._rasterizer.backward(rendered, by_color, error.sign() * (c.depth_weight / known), None)
        planes = gradients.dense()
        if c.isotropic:
            planes[LOG_SCALE] = planes[LOG_SCALE].sum(0)
        depth = float(np.abs(error.cpu().numpy()).sum(dtype=np.float64)) / known
        losses = {"depth": depth, "color": color.weighted(weights) / max(c.color_weight, 1e-12)}
        return losses, Gradients(planes, torch.ones_like(gradients.touched), None)

    def _prune(self) -> int:
        """Remove Gaussians that are transparent or too large; how many."""
        planes = self._map.planes
        keep = torch.sigmoid(planes[OPACITY_LOGIT]) >= _PRUNE_OPACITY
        if self._largest_m is not None:
            keep &= planes[LOG_SCALE].amax(0).exp() <= self._largest_m
        gone = int((~keep).sum())
        if gone:
            self._map.keep(keep)
        return gone

    def _psnr(self, target: Target) -> float:
        rendered = self._rasterizer.render(self._map.planes, target.view, differentiable=False)
        error = (rendered.color.clamp(0.0, 1.0) - target.image).cpu().numpy()
        return float(-10.0 * np.log10(max(np.square(error).mean(dtype=np.float64), 1e-10)))
