"""MonoGS's mapping (RGB-D): Gaussians of every keyframe, optimised with the poses and exposures of a window."""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from bench import registry
from bench.baselines.monogs.cameras import KeyframeCameras
from bench.baselines.monogs.density import DensityRules, ImageGradients, densify_and_prune, isotropy_gradient
from bench.baselines.monogs.images import Compared, Exposure, compare, not_black
from bench.baselines.monogs.insertion import adapted_point_size, new_gaussians, usable_depth
from bench.baselines.monogs.mapping_config import MonoGSMapperConfig
from bench.contracts.loss import LossTerm
from bench.contracts.map_view import MapView
from bench.contracts.mapper import MapNeeds, Mapper
from bench.contracts.rasterizer import Gradients, Rasterizer
from bench.errors import BenchError
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.gaussians.optimizer import LearningRates, MapOptimizer
from bench.gaussians.schema import LOG_SCALE, OPACITY_LOGIT
from bench.registry import register
from bench.supervision.photometric import Photometric, photometric
from bench.supervision.target import Target
from bench.types import Keyframe, Map, MappingReport, PinholeView, RenderedView, StereoCamera, Trajectory

if TYPE_CHECKING:
    from torch import Tensor

_DEGREE = 0
_TARGETS = 16
"""Keyframes whose images are kept as tensors."""
_REFINEMENT = Photometric(l1=0.8, dssim=0.2)
_FIRST_EVERY, _FIRST_LEAST_OPACITY, _FIRST_RESET_AT, _FIRST_RESET = 100, 0.005, 500, 0.01
_FIRST_EXTENT = 30
_DENSIFY_AT = 1 / 3
"""Of ``densify_every`` iterations, where in them: after these Gaussians of a new keyframe have become opaque."""
_UNSEEN_EVERY, _UNSEEN_OPACITY = 2001, 0.4


@dataclass(frozen=True, eq=False)
class _Comparison:
    """A keyframe's image (3, H, W) and depth (H, W), and what each pixel's difference counts (H, W)."""

    target: Target
    weights: tuple[Tensor, Tensor]


@register("mapper", "monogs", config=MonoGSMapperConfig)
class MonoGSMapper(Mapper):
    """MonoGS (Matsuki et al., 2024), RGB-D, in its single-process variant: so many iterations for each keyframe.

    The run's loss terms are not used: it has its own. Different from the original by the contracts here: gradients by
    the place in the image are those by the place in space; sizes in the image are looked at when Gaussians are removed,
    not in every view before.
    """

    map_file = "map.ply"

    def __init__(self, config: MonoGSMapperConfig) -> None:
        self.config = config
        self._rasterizer: Rasterizer = registry.build(config.rasterizer, "rasterizer")

    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        c = self.config
        self._camera, self._random = camera, np.random.default_rng(seed)
        self._map = GaussianMap(_DEGREE, self._rasterizer.device)
        rates = LearningRates(c.position_rate, c.color_rate, c.opacity_rate, c.scale_rate, c.rotation_rate)
        self._optimizer = MapOptimizer(rates)
        self._gradients = ImageGradients(self._map.device)
        self._cameras = KeyframeCameras()
        self._keyframes: dict[int, Keyframe] = {}
        self._comparisons: OrderedDict[int, _Comparison] = OrderedDict()
        self._iterations = self._window_iterations = self._refined = 0
        infinite = float("inf")
        self._first_rules = DensityRules(
            c.densify_gradient, _FIRST_EXTENT * c.clone_below_m, _FIRST_LEAST_OPACITY, infinite, infinite
        )
        self._rules = DensityRules(
            c.densify_gradient, c.clone_below_m, c.prune_opacity, c.prune_scale_m, c.prune_radius_px
        )

    def size(self) -> dict[str, int]:
        return {"gaussians": len(self._map)}

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        c, number = self.config, keyframe.frame.number
        first = not self._keyframes
        self._keyframes[number] = replace(keyframe, frame=replace(keyframe.frame, right=None))
        self._cameras.add(number, keyframe.T_world_cam, None if first else keyframe.exposure)
        self._insert(number, 1 / (c.first_downsample if first else c.downsample))
        active = [each for each in reversed(window) if each in self._keyframes]
        values: dict[str, float] = {}
        if first:
            for _ in range(c.first_iterations):
                values = self._iterate_first(number)
        else:
            rates = (c.camera_translation_rate, c.camera_rotation_rate, c.exposure_rate)
            self._cameras.begin(active, c.pose_window, *rates)
            for _ in range(c.iterations):
                values = self._iterate(active)
        self._require_finite(number)
        return MappingReport(self._psnr(number), values)

    def update_poses(self, trajectory: Trajectory) -> None:
        motions = self._cameras.follow(trajectory)
        if motions:
            stood = dict(zip(self._map.keyframes.tolist(), self._map.poses, strict=True))
            moved = {number: motion @ stood[number] for number, motion in motions.items() if number in stood}
            poses = np.array(list(moved.values())).reshape(-1, 4, 4)
            self._map.follow(Trajectory(poses, np.array(list(moved), np.int64), np.zeros(len(moved))), 0.0, 0.0)

    def finish(self) -> None:
        for _ in self.final_steps():
            pass

    def final_steps(self) -> Iterator[None]:
        """The colour refinement: one keyframe at random an iteration, L1 and SSIM, without exposure."""
        numbers = self._cameras.numbers
        while numbers and len(self._map) and self._refined < self.config.refinement_iterations:
            number = numbers[int(self._random.integers(len(numbers)))]
            rendered = self._rasterizer.render(self._map.planes, self._view(number))
            _, by_color = photometric(rendered.color, self._compared(number).target, _REFINEMENT)
            gradients = self._rasterizer.backward(rendered, by_color, None, None)
            self._refined += 1
            self._set_position_rate(self._refined)
            self._step(gradients.dense())
            yield None
        if numbers:
            self._require_finite(numbers[-1])

    def state(self) -> dict[str, Any]:
        return {
            "map": self._map.state(),
            "cameras": self._cameras.state(),
            "counts": [self._iterations, self._window_iterations, self._refined, self._optimizer.steps],
            # Numbers of 128 bits, which a restricted unpickler need not know.
            "random": json.dumps(self._random.bit_generator.state),
        }

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        self._map.restore(state["map"])
        self._cameras.restore(state["cameras"])
        self._iterations, self._window_iterations, self._refined, self._optimizer.steps = state["counts"]
        self._set_position_rate(self._refined or self._iterations)
        self._random.bit_generator.state = json.loads(state["random"])
        for keyframe in keyframes:
            self._keyframes[keyframe.frame.number] = replace(keyframe, frame=replace(keyframe.frame, right=None))

    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        return self.view().render(view)

    def render_frame(self, number: int, right: bool, view: PinholeView, depth: Map | None = None) -> RenderedView:
        """Without exposure, as the original scores; from the pose that mapping has found."""
        offset = self._camera.T_left_right if right else np.eye(4)
        left = self._cameras.corrected(number, view.T_world_cam @ np.linalg.inv(offset))
        return self.render(replace(view, T_world_cam=left @ offset))

    def view(self) -> MapView:
        return GaussianMapView(self._map, self._rasterizer, self._cameras.pose)

    def save(self, path: Path) -> None:
        self._map.save(path)

    def keyframes_of_map(self) -> npt.NDArray[np.int32]:
        return self._map.keyframes_of_all()

    def needs(self, frames: int) -> MapNeeds:
        return self.config.needs(self._camera.width * self._camera.height, frames)

    def _view(self, number: int) -> PinholeView:
        T_world_cam = self._cameras.pose(number)
        assert T_world_cam is not None
        return PinholeView.of(self._camera, T_world_cam)

    def _compared(self, number: int) -> _Comparison:
        """What a keyframe's render is compared with; the newest ones stay in memory."""
        if number not in self._comparisons:
            self._comparisons[number] = self._make_comparison(number)
            if len(self._comparisons) > _TARGETS:
                self._comparisons.popitem(last=False)
        self._comparisons.move_to_end(number)
        return self._comparisons[number]

    def _make_comparison(self, number: int) -> _Comparison:
        keyframe, share, device = self._keyframes[number], self.config.color_share, self._map.device
        image = torch.from_numpy(keyframe.frame.left).to(device).permute(2, 0, 1).float().div_(255.0).contiguous()
        depth = torch.from_numpy(self._depth(keyframe)).to(device)
        known = depth > 0
        pixels = depth.numel()
        by_color = torch.from_numpy(not_black(keyframe.frame.left)).to(device).float() * (share / (3 * pixels))
        view = PinholeView.of(self._camera, keyframe.T_world_cam)
        return _Comparison(Target(image, depth, known, view), (by_color, known.float() * ((1 - share) / pixels)))

    def _depth(self, keyframe: Keyframe) -> Map:
        """(H, W) metres, 0 where it says nothing."""
        depth = keyframe.depth.depth
        if keyframe.sky is not None:
            depth = np.where(keyframe.sky, np.nan, depth)
        return usable_depth(keyframe.frame.left, depth, self.config.max_depth_m)

    def _insert(self, number: int, share: float) -> None:
        c, keyframe = self.config, self._keyframes[number]
        depth = self._depth(keyframe)
        size = adapted_point_size(c.point_size, depth) if c.adaptive_point_size else c.point_size
        exposure = self._cameras.exposure(number)
        planes = new_gaussians(keyframe.frame.left, depth, self._view(number), share, size, exposure, self._random)
        # Birth depths of 1: the rate of the positions is in metres.
        self._map.add(number, keyframe.T_world_cam, planes, torch.ones(planes.shape[1]))
        self._gradients.reset(len(self._map))

    def _learn_from(self, number: int, exposure: Exposure, pose: bool) -> tuple[Gradients, Compared]:
        """Render a keyframe and compare it; the gradients may lie in memory that the next call writes again."""
        view, against = self._view(number), self._compared(number)
        rendered = self._rasterizer.render(self._map.planes, view)
        target = against.target
        compared = compare(rendered.color, rendered.depth, target.image, target.depth, against.weights, exposure)
        gradients = self._rasterizer.backward(rendered, compared.by_color, compared.by_depth, None, pose=pose)
        self._gradients.add(self._map.planes, view, gradients)
        return gradients, compared

    def _iterate_first(self, number: int) -> dict[str, float]:
        """One iteration on the first keyframe alone, without exposure."""
        gradients, compared = self._learn_from(number, (0.0, 0.0), pose=False)
        if self._iterations % _FIRST_EVERY == 0:
            self._densify(self._first_rules, ())
        else:
            self._step(gradients.dense())
        if self._iterations == _FIRST_RESET_AT:
            self._map.planes[OPACITY_LOGIT].clamp_(max=_logit(_FIRST_RESET))
            self._forget_opacity_moments()
        self._iterations += 1
        self._set_position_rate(self._iterations)
        return {"color": compared.color_value, "depth": compared.depth_value}

    def _iterate(self, active: Sequence[int]) -> dict[str, float]:
        """One iteration on the window, newest keyframe first, and some older ones: map, poses and exposures."""
        older = [number for number in self._keyframes if number not in active]
        drawn = self._random.permutation(older)[: self.config.older_views].tolist()
        total = torch.zeros(self._map.planes.shape, device=self._map.device)
        seen = torch.zeros(len(self._map), dtype=torch.bool, device=self._map.device)
        views, values, steps = [*active, *drawn], np.zeros(2), []
        for number in views:
            learns = self._cameras.learns(number)
            gradients, compared = self._learn_from(number, self._cameras.exposure(number), pose=learns)
            total += gradients.dense()
            seen |= gradients.touched
            values += (compared.color_value, compared.depth_value)
            if learns:
                assert gradients.twist is not None
                steps.append((number, gradients.twist.cpu().numpy(), compared.by_exposure))
        total[LOG_SCALE] += isotropy_gradient(self._map.planes, self.config.isotropy)
        self._iterations += 1
        self._window_iterations += 1
        self._update_map(total, seen, [self._view(number) for number in views])
        for number, by_twist, by_exposure in steps:
            self._cameras.step(number, by_twist, by_exposure)
        color, depth = values / len(views)
        return {"color": float(color), "depth": float(depth)}

    def _update_map(self, total: Tensor, seen: Tensor, views: Sequence[PinholeView]) -> None:
        """Densify and prune where it is time to, which leaves no gradients to step by; else a step."""
        every = self.config.densify_every
        if self._window_iterations % every == int(every * _DENSIFY_AT):
            self._densify(self._rules, views)
        else:
            if self._iterations % _UNSEEN_EVERY == 0:
                self._map.planes[OPACITY_LOGIT, ~seen] = _logit(_UNSEEN_OPACITY)
                self._forget_opacity_moments()
                total[OPACITY_LOGIT] = 0.0
            self._step(total)
        self._set_position_rate(self._iterations)

    def _densify(self, rules: DensityRules, views: Sequence[PinholeView]) -> None:
        densify_and_prune(self._map, self._gradients.means(), rules, views, self._random)
        self._gradients.reset(len(self._map))

    def _step(self, by_planes: Tensor) -> None:
        """One step of Adam of every Gaussian, also of those that no view touched: their moments go on."""
        every = torch.ones(len(self._map), dtype=torch.bool, device=self._map.device)
        self._optimizer.step(self._map, Gradients(by_planes, every, None))

    def _set_position_rate(self, iterations: int) -> None:
        self._optimizer.rates = replace(self._optimizer.rates, position=self.config.position_rate_at(iterations))

    def _forget_opacity_moments(self) -> None:
        self._map.first_moment[OPACITY_LOGIT] = 0.0
        self._map.second_moment[OPACITY_LOGIT] = 0.0

    def _require_finite(self, number: int) -> None:
        if not bool(torch.isfinite(self._map.planes).all()):
            raise BenchError(
                f"after keyframe {number} the map has Gaussians that are not finite. Lower the rates of mapper=monogs."
            )

    def _psnr(self, number: int) -> float:
        rendered = self._rasterizer.render(self._map.planes, self._view(number), differentiable=False)
        error = (rendered.color.clamp(0.0, 1.0) - self._compared(number).target.image).square()
        return float(-10.0 * np.log10(max(float(error.cpu().numpy().mean(dtype=np.float64)), 1e-10)))


def _logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))
