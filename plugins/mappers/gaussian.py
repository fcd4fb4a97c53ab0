"""The mapping of BGS-SLAM: Gaussians seeded from stereo depth and optimised over a window of keyframes."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench import registry
from bench.contracts.loss import LossTerm, NotFiniteError
from bench.contracts.map_view import MapView
from bench.contracts.mapper import MapNeeds, Mapper
from bench.contracts.rasterizer import Rasterizer
from bench.errors import BenchError
from bench.gaussians.loss_stack import LossStack
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView, as_arrays
from bench.gaussians.mapping_config import GaussianMapperConfig
from bench.gaussians.needs import map_needs
from bench.gaussians.optimizer import LearningRates, MapOptimizer
from bench.gaussians.pose_refinement import PoseRefinement
from bench.gaussians.schema import OPACITY_LOGIT
from bench.gaussians.seeding import depth_to_seed_from, seed_gaussians
from bench.registry import register
from bench.supervision.appearance import Appearance
from bench.supervision.moving import MovingThings
from bench.supervision.target import Target, right_target_of, target_of
from bench.types import Event, Keyframe, Map, MappingReport, Mask, PinholeView, RenderedView, StereoCamera, Trajectory

# Steps of a new keyframe's pose before it adds Gaussians.
_SETTLING_STEPS = 12


@register("mapper", "gaussian", config=GaussianMapperConfig)
class GaussianMapper(Mapper):
    """BGS-SLAM's mapping: seeds from stereo depth, the loss terms of the run, a window of keyframes plus replay."""

    map_file = "map.ply"

    def __init__(self, config: GaussianMapperConfig) -> None:
        self.config = config
        self._rasterizer: Rasterizer = registry.build(config.rasterizer, "rasterizer")
        self.uses_right_images = config.right_images > 0 or config.camera_color != "none"

    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        c = self.config
        self._camera, self._losses = camera, LossStack(losses)
        self._random = np.random.default_rng(seed)
        rates = LearningRates(c.position_rate, c.color_rate, c.opacity_rate, c.scale_rate, c.rotation_rate)
        self._optimizer = MapOptimizer(rates, c.second_moment_decay)
        self._map = GaussianMap(c.sh_degree, self._rasterizer.device)
        self._keyframes: dict[int, Keyframe] = {}
        self._views: dict[tuple[int, bool], PinholeView] = {}
        self._targets: OrderedDict[tuple[int, bool], tuple[Target, Target]] = OrderedDict()
        self._appearance = Appearance(camera, c.camera_color, c.exposure)
        self._refinement = PoseRefinement(c.pose_refinement)
        self._moving = MovingThings(camera) if c.moving else None
        self._final_done = 0
        self._round: list[int] = []  # whose turn it still is in this round of the last optimisation
        self._happened: list[tuple[str, dict[str, Any]]] = []

    @property
    def gaussians(self) -> int:
        """Number of Gaussians in the map."""
        return len(self._map)

    def size(self) -> dict[str, int]:
        return {"gaussians": self.gaussians}

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        number = keyframe.frame.number
        self._keyframes[number] = self._to_keep(keyframe)
        self._appearance.camera_colors.learn(keyframe)
        self._refinement.add(number)
        self._let_go(window)
        if self._moving is not None:
            for changed in self._moving.add(keyframe):
                self._targets.pop((changed, False), None)
        self._settle(number)
        self._seed(keyframe)
        coarse = round(self.config.iterations * self.config.coarse_share)
        values: dict[str, float] = {}
        for iteration in range(self.config.iterations):
            step = f"keyframe {number}, iteration {iteration + 1} of {self.config.iterations}"
            values = self._iterate(self._choose(number, window), iteration < coarse, step) or values
        self._require_finite(f"after the iterations of keyframe {number}")
        self._prune()
        psnr_db, events = self._psnr(number), self._events(number)
        return MappingReport(psnr_db, values, events)

    def update_poses(self, trajectory: Trajectory) -> None:
        for number, pose in zip(trajectory.numbers.tolist(), trajectory.T_world_cam, strict=True):
            known = self._keyframes.get(number)
            if known is not None and not np.array_equal(known.T_world_cam, pose):
                self._keyframes[number] = replace(known, T_world_cam=pose)
                self._forget_views(number)
        c = self.config
        motion = self._map.follow(trajectory, c.follow_corrections_m, c.follow_corrections_deg)
        if motion.keyframes:
            self._happened.append(("map_moved", asdict(motion)))

    def finish(self) -> None:
        for _ in self.final_steps():
            pass

    def final_steps(self) -> Iterator[tuple[Event, ...]]:
        if not self._keyframes:
            return
        numbers = list(self._keyframes)
        coarse = self.config.final_coarse_iterations * len(numbers)
        last = coarse + self.config.final_iterations * len(numbers)
        while self._final_done < last:
            if self._final_done == coarse and self.config.refine_stride:
                self._prune()
                for number in numbers:
                    self._seed(self._keyframes[number], refine=True)
            if not self._round:
                self._round = self._random.permutation(numbers).tolist()
            step = f"last optimisation, iteration {self._final_done + 1} of {last}"
            self._iterate(self._round.pop(), self._final_done < coarse, step)
            self._final_done += 1
            yield self._events(numbers[-1])
        self._require_finite("after the last optimisation")
        self._prune()
        yield self._events(numbers[-1])

    def state(self) -> dict[str, Any]:
        return {
            "map": self._map.state(),
            "optimizer_steps": self._optimizer.steps,
            "poses": {number: torch.from_numpy(known.T_world_cam) for number, known in self._keyframes.items()},
            "final_done": self._final_done,
            "round": list(self._round),
            "appearance": self._appearance.state(),
            "refinement": self._refinement.state(),
            # Numbers of 128 bits, which a restricted unpickler need not know.
            "random": json.dumps(self._random.bit_generator.state),
        }

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        for keyframe in keyframes:
            if self._moving is not None:
                self._moving.add(keyframe)
            pose = state["poses"].get(keyframe.frame.number)
            if pose is not None:
                self._keyframes[keyframe.frame.number] = self._to_keep(replace(keyframe, T_world_cam=pose.numpy()))
        self._appearance.restore(state["appearance"])
        self._refinement.restore(state["refinement"])
        self._map.restore(state["map"])
        self._optimizer.steps = state["optimizer_steps"]
        self._final_done, self._round = state["final_done"], list(state["round"])
        self._random.bit_generator.state = json.loads(state["random"])

    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        return self.view().render(view)

    def render_frame(self, number: int, right: bool, view: PinholeView, depth: Map | None = None) -> RenderedView:
        if self._refinement.on:
            offset = self._camera.T_left_right if right else np.eye(4)
            left = self._refinement.corrected(number, view.T_world_cam @ np.linalg.inv(offset))
            view = replace(view, T_world_cam=left @ offset)
        rendered = self._rasterizer.render(self._map.planes, view, differentiable=False)
        return as_arrays(replace(rendered, color=self._appearance.shown(rendered.color, number, right)))

    def view(self) -> MapView:
        return GaussianMapView(self._map, self._rasterizer)

    def pictures(self) -> Iterator[tuple[str, int, Mask]]:
        if self._moving is not None:
            for number in self._moving.numbers:
                yield "moving", number, self._moving.mask(number)

    def save(self, path: Path) -> None:
        self._map.save(path)

    def needs(self, frames: int) -> MapNeeds:
        return map_needs(self._camera.width * self._camera.height, frames, self.config.sh_degree)

    def _let_go(self, window: Sequence[int]) -> None:
        """Forget what is beyond ``replayed_keyframes``: the keyframe whose neighbours are closest in frame numbers."""
        numbers = np.array(sorted(self._keyframes))
        if len(numbers) <= self.config.replayed_keyframes:
            return
        gaps = (numbers[2:] - numbers[:-2]).astype(np.float64)
        gaps[np.isin(numbers[1:-1], window)] = np.inf
        if np.isfinite(gaps).any():
            number = int(numbers[1 + np.argmin(gaps)])
            del self._keyframes[number]
            self._forget_views(number)
            self._targets.pop((number, False), None)
            self._targets.pop((number, True), None)

    def _to_keep(self, keyframe: Keyframe) -> Keyframe:
        """What is learned from again: right images only where they are, since those of a long sequence fill memory."""
        if self.config.right_images > 0:
            keyframe.frame.pair("mapper.right_images", "mapper.right_images=0")
            return keyframe
        return replace(keyframe, frame=replace(keyframe.frame, right=None))

    def _view(self, number: int, right: bool = False) -> PinholeView:
        """The view of a keyframe, made once per pose."""
        if (number, right) not in self._views:
            T_world_cam = self._refinement.corrected(number, self._keyframes[number].T_world_cam)
            T_world_cam = T_world_cam @ self._camera.T_left_right if right else T_world_cam
            self._views[number, right] = PinholeView.of(self._camera, T_world_cam)
        return self._views[number, right]

    def _forget_views(self, number: int) -> None:
        self._views.pop((number, False), None)
        self._views.pop((number, True), None)

    def _target(self, number: int, half: bool, right: bool = False) -> Target:
        """The cached target of a keyframe; the least recently used one is dropped."""
        pair = self._targets.pop((number, right), None)
        if pair is None:
            view, device, c = self._view(number, right), self._map.device, self.config
            if right:
                full = right_target_of(self._keyframes[number], view, c.depth_range_m, device)
            else:
                ignored = None if self._moving is None else self._moving.mask(number)
                full = target_of(self._keyframes[number], view, c.depth_range_m, device, c.color_pixels, ignored)
            pair = (full, full.halved())
        self._targets[number, right] = pair
        while len(self._targets) > self.config.cached_targets:
            self._targets.popitem(last=False)
        return pair[int(half)]

    def _choose(self, newest: int, window: Sequence[int]) -> int:
        """Draw a view: the newest keyframe, one of the window, or an older one."""
        draw = self._random.random()
        others = [n for n in window if n != newest and n in self._keyframes]
        if draw >= self.config.newest_share and others and draw < self.config.newest_share + self.config.window_share:
            return others[int(self._random.integers(len(others)))]
        older = [n for n in self._keyframes if n != newest and n not in others]
        if draw >= self.config.newest_share + self.config.window_share and older:
            return older[int(self._random.integers(len(older)))]
        return newest

    def _iterate(self, number: int, half: bool, step: str, map_learns: bool = True) -> dict[str, float]:
        """One render of a keyframe, its losses, and one step of the optimizer; an error says which ``step`` it was.

        Without ``map_learns`` the map stays, and only the keyframe's exposure and pose learn.
        """
        share = self.config.right_images if map_learns else 0.0
        right = share > 0 and bool(self._random.random() < share)
        target, view = self._target(number, half, right), self._view(number, right)
        rendered = self._rasterizer.render(self._map.planes, view.halved() if half else view)
        if not right:
            self._appearance.exposures.learn(number, rendered.color, rendered.alpha, target)
        shown = self._appearance.shown(rendered.color, number, right, target.limit)
        try:
            values, (by_color, by_depth, by_alpha) = self._losses.evaluate(replace(rendered, color=shown), target)
        except NotFiniteError as error:
            size = "at half resolution" if half else "at full resolution"
            raise BenchError(f"{step} (view of frame {number}, {size}): {error}") from error
        refine = self._refinement.on and not right
        by_color = self._appearance.back(by_color, shown, number, right, target.limit)
        by_parameters = self._rasterizer.backward(rendered, by_color, by_depth, by_alpha, pose=refine)
        if map_learns:
            self._optimizer.step(self._map, by_parameters)
        if refine:
            assert by_parameters.twist is not None
            self._refinement.step(number, by_parameters.twist)
            self._forget_views(number)
        return values

    def _settle(self, number: int) -> None:
        """Fit exposure and pose of a new keyframe to the map before it adds to it, where they are learned."""
        if not self.config.exposure and not self._refinement.on:
            return
        rendered = self._rasterizer.render(self._map.planes, self._view(number).halved(), differentiable=False)
        target = self._target(number, half=True)
        self._appearance.exposures.learn(number, rendered.color, rendered.alpha, target, share=1.0)
        for _ in range(_SETTLING_STEPS if self.gaussians and self._refinement.on else 0):
            self._iterate(number, True, f"settling of keyframe {number}", map_learns=False)

    def _seed(self, keyframe: Keyframe, refine: bool = False) -> None:
        """Add Gaussians where the map does not explain the keyframe yet (METHOD, "seeding")."""
        c, number = self.config, keyframe.frame.number
        seeding = replace(c.seeding, stride=c.refine_stride, min_error=c.refine_error) if refine else c.seeding
        view, target = self._view(number), self._target(number, half=False)
        margin = seeding.margin_columns(view.width)
        unexplained = np.ones((view.height, view.width + 2 * margin), bool)
        if self.gaussians:
            rendered = self._rasterizer.render(self._map.planes, view.widened(margin), differentiable=False)
            shown = self._appearance.shown(rendered.color, number, right=False)
            error = (shown[..., margin : margin + view.width] - target.image).abs().mean(0)
            error = torch.nn.functional.pad(error, (margin, margin))
            unexplained = ((rendered.alpha < seeding.max_alpha) | (error > seeding.min_error)).cpu().numpy()
        if self._moving is not None:
            unexplained[:, margin : margin + view.width] &= ~self._moving.mask(number)
        depth = depth_to_seed_from(keyframe, c.depth_range_m, seeding)
        image = self._appearance.in_map(number, keyframe.frame.left)
        planes, depths = seed_gaussians(image, depth, keyframe.sky, unexplained, view, seeding)
        self._map.add(number, self._keyframes[number].T_world_cam, planes, depths)

    def _require_finite(self, when: str) -> None:
        """``BenchError`` that says ``when``, for a map that holds NaN: gradients can be no numbers where losses are."""
        if not bool(torch.isfinite(self._map.planes).all()):
            spoilt = int((~torch.isfinite(self._map.planes)).any(dim=0).sum())
            raise BenchError(
                f"{when}: {spoilt} of {self.gaussians} Gaussians are not finite. Lower the mapper's rates, or see "
                "which loss term does it with its weight at 0."
            )

    def _prune(self) -> None:
        """Remove Gaussians below the opacity threshold (paper, "Implementation Details")."""
        keep = torch.sigmoid(self._map.planes[OPACITY_LOGIT]) >= self.config.prune_opacity
        if bool(keep.all()):
            return
        self._happened.append(("pruned", {"count": int((~keep).sum())}))
        self._map.keep(keep)

    def _events(self, number: int) -> tuple[Event, ...]:
        """What happened to the map since this was asked last; keyframe ``number`` is the newest."""
        events = tuple(Event(kind, number, values) for kind, values in self._happened)
        self._happened = []
        return events

    def _psnr(self, number: int) -> float:
        rendered = self._rasterizer.render(self._map.planes, self._view(number), differentiable=False)
        shown = self._appearance.shown(rendered.color, number, right=False)
        error = shown.clamp(0.0, 1.0) - self._target(number, half=False).image
        return float(-10.0 * torch.log10((error * error).mean().clamp_min(1e-10)))
