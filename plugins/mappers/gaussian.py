"""The mapping of BGS-SLAM: Gaussians seeded from stereo depth and optimised over a window of keyframes."""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from bench import registry
from bench.contracts.loss import LossTerm, NotFiniteError
from bench.contracts.map_view import MapView
from bench.contracts.mapper import CannotRenderError, MapNeeds, Mapper
from bench.contracts.rasterizer import Rasterizer, Rendered
from bench.errors import BenchError
from bench.gaussians.chunk_schedule import ChunkSchedule
from bench.gaussians.chunked_map import Block, ChunkDrawing, ChunkedMap
from bench.gaussians.last_optimisation import LastOptimisation
from bench.gaussians.loss_stack import LossStack
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView, as_arrays
from bench.gaussians.mapping_config import GaussianMapperConfig
from bench.gaussians.needs import map_needs
from bench.gaussians.optimizer import LearningRates, MapOptimizer
from bench.gaussians.pose_refinement import PoseRefinement
from bench.gaussians.replay import Replay
from bench.gaussians.schema import OPACITY_LOGIT
from bench.gaussians.seeding import depth_to_seed_from, seed_gaussians
from bench.io.array_store import ArrayStore, DamagedError
from bench.process_memory import MemoryBudget, release_free_memory
from bench.registry import register
from bench.supervision.appearance import Appearance
from bench.supervision.moving import MovingThings
from bench.types import Event, Keyframe, Map, MappingReport, Mask, PinholeView, RenderedView, StereoCamera, Trajectory

log = logging.getLogger(__name__)

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
        self._schedule = ChunkSchedule(c.chunk_m, c.live_m, c.live_keyframes)
        self._last: LastOptimisation | None = None
        self._lost_told = 0
        self._room = True  # on disk, for what is left behind
        self._appearance = Appearance(camera, c.camera_color, c.exposure)
        self._refinement = PoseRefinement(c.pose_refinement)
        self._moving = MovingThings(camera) if c.moving else None
        self._folder = TemporaryDirectory(prefix="bgs-map-")  # a run gives a store in its own folder
        store, live = ArrayStore(Path(self._folder.name)), GaussianMap(c.sh_degree, self._rasterizer.device)
        follow = (c.follow_corrections_m, c.follow_corrections_deg)
        drawing = ChunkDrawing(c.far_m, c.detail_m, camera.fx, *follow, c.chunk_memory_mb * 1e6)
        self._map = ChunkedMap(live, store, drawing)
        moving, correct = self._moving, self._refinement.corrected
        ignored = (lambda _: None) if moving is None else moving.mask
        self._replay = Replay(camera, c, store, correct, ignored, live.device)
        self._happened: list[tuple[str, dict[str, Any]]] = []

    def use_store(self, store: ArrayStore) -> None:
        self._map.store = store
        self._replay.use_store(store)

    def use_memory_budget(self, budget: MemoryBudget) -> None:
        self._map.budget = budget

    @property
    def gaussians(self) -> int:
        """Number of Gaussians in the map."""
        return len(self._map)

    def size(self) -> dict[str, int]:
        return {"gaussians": self.gaussians}

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        number = keyframe.frame.number
        self._replay.keyframes.add(self._to_keep(keyframe))
        self._appearance.camera_colors.learn(keyframe)
        self._refinement.add(number)
        self._come_to(number)
        if self._moving is not None:
            for changed in self._moving.add(keyframe):
                self._replay.forget_target(changed)
        self._settle(number)
        self._seed(number)
        values: dict[str, float] = {}
        for iteration, (half, of) in enumerate(self._iterations(), 1):
            step = f"keyframe {number}, iteration {iteration} of {of}"
            values = self._iterate(self._choose(number, window), half, step) or values
        self._require_finite(f"after the iterations of keyframe {number}")
        self._leave_behind(number)
        self._prune()
        psnr_db, events = self._psnr(number), self._events(number)
        return MappingReport(psnr_db, values, events)

    def _iterations(self) -> Iterator[tuple[bool, str]]:
        """The iterations of a new keyframe, by number or by time: whether each is at half resolution, and of how many
        it is one."""
        c, begin = self.config, time.monotonic()
        if c.seconds == 0:
            coarse = round(c.iterations * c.coarse_share)
            yield from ((iteration < coarse, str(c.iterations)) for iteration in range(c.iterations))
            return
        passed = 0.0
        while passed < c.seconds:
            yield passed < c.seconds * c.coarse_share, f"those of {c.seconds:g} s"
            passed = time.monotonic() - begin

    def update_poses(self, trajectory: Trajectory) -> None:
        self._replay.follow(trajectory)
        motion = self._map.follow(trajectory)
        if motion.keyframes:
            self._happened.append(("map_moved", asdict(motion)))

    def finish(self) -> None:
        for _ in self.final_steps():
            pass

    def final_steps(self) -> Iterator[tuple[Event, ...]]:
        live = self._schedule.live
        if not live:
            return
        self._map.look_from(self._replay.place(live[-1]))
        if self._last is not None and not self._last.of_rest:
            while not self._last.over:
                self._step_of_last(self._last)
                yield self._events(live[-1])
            self._freeze(self._last.numbers)
            self._last = None
        if self._last is None:
            self._last = self._last_optimisation(self._schedule.live, of_rest=True)
        while not self._last.over:
            self._step_of_last(self._last)
            yield self._events(live[-1])
        self._require_finite("after the last optimisation")
        self._prune()
        yield self._events(live[-1])

    def state(self) -> dict[str, Any]:
        of_map, of_keyframes = self._map.state(), self._replay.state()
        return {
            "map": of_map,
            "keyframes": of_keyframes,
            "stored": [*of_map["stored"], *of_keyframes["stored"]],
            "schedule": self._schedule.state(),
            "last": None if self._last is None else asdict(self._last),
            "optimizer_steps": self._optimizer.steps,
            "appearance": self._appearance.state(),
            "refinement": self._refinement.state(),
            # Numbers of 128 bits, which a restricted unpickler need not know.
            "random": json.dumps(self._random.bit_generator.state),
        }

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        if self._moving is not None:  # all others lie in the store
            for keyframe in keyframes:
                self._moving.add(keyframe)
        self._map.store.discard(state["stored"])
        self._replay.restore(state["keyframes"])
        self._schedule.restore(state["schedule"])
        self._last = None if state["last"] is None else LastOptimisation(**state["last"])
        self._appearance.restore(state["appearance"])
        self._refinement.restore(state["refinement"])
        self._map.restore(state["map"])
        self._lost_told = len(self._map.lost)
        self._optimizer.steps = state["optimizer_steps"]
        self._random.bit_generator.state = json.loads(state["random"])
        if self._schedule.live:
            self._map.look_from(self._replay.place(self._schedule.live[-1]))

    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        self._look_from(view)
        return self.view().render(view)

    def render_frame(self, number: int, right: bool, view: PinholeView, depth: Map | None = None) -> RenderedView:
        if self._refinement.on:
            offset = self._camera.T_left_right if right else np.eye(4)
            left = self._refinement.corrected(number, view.T_world_cam @ np.linalg.inv(offset))
            view = replace(view, T_world_cam=left @ offset)
        self._look_from(view)
        rendered = self._render(view)
        return as_arrays(replace(rendered, color=self._appearance.shown(rendered.color, number, right)))

    def view(self) -> MapView:
        return GaussianMapView(self._map, self._rasterizer)

    def pictures(self) -> Iterator[tuple[str, int, Mask]]:
        if self._moving is not None:
            for number in self._moving.numbers:
                yield "moving", number, self._moving.mask(number)

    def save(self, path: Path) -> None:
        self._map.save(path)

    def keyframes_of_map(self) -> npt.NDArray[np.int32]:
        return self._map.keyframes_of_all()

    def needs(self, frames: int) -> MapNeeds:
        c = self.config
        return map_needs(self._camera.width * self._camera.height, frames, c.sh_degree, c.live_m)

    def _look_from(self, view: PinholeView) -> None:
        """Have what a view needs; raises ``CannotRenderError`` where a part of that is lost."""
        place = view.T_world_cam[:3, 3]
        self._map.look_from(place)
        for block in self._map.lost_near(place):
            raise CannotRenderError(_lost_in_words(block))

    def _come_to(self, number: int) -> None:
        """A new keyframe is there; what was left behind near its place is drawn."""
        self._schedule.add(number, self._replay.keyframes.pose)
        live, most = self._schedule.live, self.config.live_keyframes
        self._replay.forget_ages_but(live)
        if len(live) > most and self._room:
            self._page(live[-most - 1])
        self._map.look_from(self._replay.place(number))

    def _page(self, number: int) -> None:
        """The images of a keyframe go to disk, from where they are learned again; if they can't, they stay."""
        try:
            self._replay.let_go(number)
        except BenchError as error:
            log.warning("from keyframe %d on images stay in memory: %s", number, error)
            self._room = False

    def _leave_behind(self, number: int) -> None:
        """Go on with the last optimisation of what the camera has left behind, by as much as a keyframe brings."""
        if not self._room:
            return
        due = self._schedule.due(self._replay.place(number), self._replay.keyframes.pose)
        if self._last is None and due:
            self._last = self._last_optimisation(due[0])
        if self._last is None:
            return
        self._map.look_from(self._replay.place(self._last.numbers[len(self._last.numbers) // 2]))
        per_keyframe = math.ceil(self._last.steps / len(self._last.numbers))
        for _ in range(per_keyframe * max(len(due), 1)):
            if self._last.over:
                break
            self._step_of_last(self._last)
        if self._last.over:
            self._freeze(self._last.numbers)
            self._last = None
        self._map.look_from(self._replay.place(number))

    def _last_optimisation(self, numbers: Sequence[int], of_rest: bool = False) -> LastOptimisation:
        c = self.config
        neighbours, counts = self._neighbours(numbers), (c.final_coarse_iterations, c.final_iterations)
        return LastOptimisation(list(numbers), neighbours, *counts, seeds=c.refine_stride > 0, of_rest=of_rest)

    def _neighbours(self, numbers: Sequence[int]) -> list[int]:
        """Other keyframes, live or on disk, not farther from these than ``live_m``."""
        c, live = self.config, self._schedule.live
        if not np.isfinite(c.live_m):
            return []
        places = np.array([self._replay.place(number) for number in numbers])
        near = {number for place in places for number in self._map.keyframes_within(place, c.live_m)}
        near.update(number for number in live if self._near(number, numbers, c.live_m))
        return sorted(near.difference(numbers))

    def _near(self, number: int, others: Iterable[int], distance_m: float) -> bool:
        """Whether a keyframe is at most so many metres from one of the others."""
        place = self._replay.place(number)
        return any(np.linalg.norm(self._replay.place(other) - place) <= distance_m for other in others)

    def _step_of_last(self, last: LastOptimisation) -> None:
        """One iteration of the last optimisation of some keyframes, with the second seeding at its time."""
        if last.done == last.first_fine and last.seeds:
            self._prune()
            release_free_memory()  # the map grows to several times its size; that would not fit between what is in use
            for number in last.numbers:
                self._seed(number, refine=True)
            release_free_memory()
        step = f"last optimisation, iteration {last.done + 1} of {last.steps}"
        number, half = last.next(self._random)
        try:
            self._iterate(number, half, step)
        except DamagedError as error:
            if number not in last.neighbours:
                raise
            log.warning("keyframe %d no longer takes part: %s", number, error)
            last.neighbours.remove(number)

    def _freeze(self, chunk: Sequence[int]) -> None:
        """A chunk is done: to disk with it; where that can't be written it stays in memory."""
        self._prune()
        self._require_finite(f"after the last optimisation of keyframes {chunk[0]} to {chunk[-1]}")
        try:
            for number in chunk:
                self._replay.let_go(number)
            self._map.freeze(chunk)
        except BenchError as error:
            log.warning("from keyframe %d on the map stays in memory: %s", chunk[0], error)
            self._room = False
            return
        self._schedule.freeze(list(chunk))
        release_free_memory()
        self._happened.append(("chunk_frozen", {"first": chunk[0], "last": chunk[-1]}))

    def _to_keep(self, keyframe: Keyframe) -> Keyframe:
        """What is learned from again: right images only where they are, since those of a long sequence fill memory."""
        if self.config.right_images > 0:
            keyframe.frame.pair("mapper.right_images", "mapper.right_images=0")
            return keyframe
        return replace(keyframe, frame=replace(keyframe.frame, right=None))

    def _choose(self, newest: int, window: Sequence[int]) -> int:
        """Draw a view: the newest keyframe, one of the window, or an older one."""
        draw = self._random.random()
        live = self._schedule.live
        others = [n for n in window if n != newest and n in live]
        if draw >= self.config.newest_share and others and draw < self.config.newest_share + self.config.window_share:
            return others[int(self._random.integers(len(others)))]
        older = [n for n in live if n != newest and n not in others]
        if draw >= self.config.newest_share + self.config.window_share and older:
            return self._replay.older(older, self._optimizer.steps, self._random)
        return newest

    def _render(self, view: PinholeView, differentiable: bool = False) -> Rendered:
        return self._rasterizer.render(self._map.seen_from(view.T_world_cam[:3, 3]), view, differentiable)

    def _iterate(self, number: int, half: bool, step: str, map_learns: bool = True) -> dict[str, float]:
        """One render of a keyframe, its losses, and one step of the optimizer; an error says which ``step`` it was.

        Without ``map_learns`` the map stays, and only the keyframe's exposure and pose learn.
        """
        share = self.config.right_images if map_learns else 0.0
        right = share > 0 and bool(self._random.random() < share)
        target, view = self._replay.target(number, half, right), self._replay.view(number, right)
        rendered = self._render(view.halved() if half else view, differentiable=True)
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
        by_images, live = (by_color, by_depth, by_alpha), self._map.live
        if map_learns:
            twist = self._optimizer.learn(live, self._rasterizer, rendered, by_images, pose=refine)
            self._replay.learned(number, self._optimizer.steps)
        else:
            twist = self._rasterizer.backward(rendered, *by_images, pose=True, learning=0).twist
        if refine:
            assert twist is not None
            self._refinement.step(number, twist)
            self._replay.forget_view(number)
        return values

    def _settle(self, number: int) -> None:
        """Fit exposure and pose of a new keyframe to the map before it adds to it, where they are learned."""
        if not self.config.exposure and not self._refinement.on:
            return
        rendered = self._render(self._replay.view(number).halved())
        target = self._replay.target(number, half=True)
        self._appearance.exposures.learn(number, rendered.color, rendered.alpha, target, share=1.0)
        for _ in range(_SETTLING_STEPS if self.gaussians and self._refinement.on else 0):
            self._iterate(number, True, f"settling of keyframe {number}", map_learns=False)

    def _seed(self, number: int, refine: bool = False) -> None:
        """Add Gaussians where the map does not explain the keyframe yet (METHOD, "seeding")."""
        c, keyframe = self.config, self._replay.keyframes[number]
        seeding = replace(c.seeding, stride=c.refine_stride, min_error=c.refine_error) if refine else c.seeding
        view, target = self._replay.view(number), self._replay.target(number, half=False)
        margin = seeding.margin_columns(view.width)
        unexplained = np.ones((view.height, view.width + 2 * margin), bool)
        if self.gaussians:
            wide = view.widened(margin)
            rendered = self._render(wide)
            shown = self._appearance.shown(rendered.color, number, right=False)
            error = (shown[..., margin : margin + view.width] - target.image).abs().mean(0)
            error = torch.nn.functional.pad(error, (margin, margin))
            uncovered, wrong = rendered.alpha < seeding.max_alpha, error > seeding.min_error
            if c.revisit_error > seeding.min_error:
                frozen = self._map.frozen_seen_from(view.T_world_cam[:3, 3])
                known = self._rasterizer.render(frozen, wide, differentiable=False).alpha > seeding.max_alpha
                wrong &= ~known | (error > c.revisit_error)
            unexplained = (uncovered | wrong).cpu().numpy()
        if self._moving is not None:
            unexplained[:, margin : margin + view.width] &= ~self._moving.mask(number)
        depth = depth_to_seed_from(keyframe, c.depth_range_m, seeding)
        image = self._appearance.in_map(number, keyframe.frame.left)
        seeds = seed_gaussians(image, depth, keyframe.sky, unexplained, view, seeding)
        sky, live = seeds.of_sky, self._map.live
        live.add(number, keyframe.T_world_cam, seeds.planes[:, ~sky], seeds.depths[~sky])
        cell = seeding.stride / view.fx
        live.add_sky(view.T_world_cam[:3, 3], seeds.planes[:, sky], seeds.depths[sky], cell)

    def _require_finite(self, when: str) -> None:
        """``BenchError`` that says ``when``, for a map that holds NaN: gradients can be no numbers where losses are."""
        planes = self._map.live.planes
        if not bool(torch.isfinite(planes).all()):
            spoilt = int((~torch.isfinite(planes)).any(dim=0).sum())
            raise BenchError(
                f"{when}: {spoilt} of {self.gaussians} Gaussians are not finite. Lower the mapper's rates, or see "
                "which loss term does it with its weight at 0."
            )

    def _prune(self) -> None:
        """Remove Gaussians below the opacity threshold (paper, "Implementation Details")."""
        keep = torch.sigmoid(self._map.live.planes[OPACITY_LOGIT]) >= self.config.prune_opacity
        if bool(keep.all()):
            return
        self._happened.append(("pruned", {"count": int((~keep).sum())}))
        self._map.live.keep(keep)

    def _events(self, number: int) -> tuple[Event, ...]:
        """What happened to the map since this was asked last; keyframe ``number`` is the newest."""
        for block in self._map.lost[self._lost_told :]:
            self._happened.append(("warning", {"text": _lost_in_words(block)}))
        self._lost_told = len(self._map.lost)
        events = tuple(Event(kind, number, values) for kind, values in self._happened)
        self._happened = []
        return events

    def _psnr(self, number: int) -> float:
        rendered = self._render(self._replay.view(number))
        shown = self._appearance.shown(rendered.color, number, right=False)
        error = shown.clamp(0.0, 1.0) - self._replay.target(number, half=False).image
        return float(-10.0 * torch.log10((error * error).mean().clamp_min(1e-10)))


def _lost_in_words(block: Block) -> str:
    return f"the map of keyframes {block.keyframes[0]} to {block.keyframes[-1]} is lost: its file was damaged"
