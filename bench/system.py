"""The SLAM loop: the one place where the stages meet.

Data flows one way: data set -> tracker -> keyframer -> stereo -> sky -> mapper -> run folder. Scoring comes afterwards
and reads the run folder only. The part before the mapper (the front end) never looks at the map, so it may run ahead
in a thread of its own (``pipeline=parallel``) without changing a single bit of the result.
"""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench import registry
from bench.cache import cached_depth_source, cached_segmenter, cost_of
from bench.config import RunConfig
from bench.contracts.dataset import Dataset
from bench.contracts.keyframer import Keyframer
from bench.contracts.mapper import Mapper
from bench.contracts.rasterizer import PinholeView
from bench.contracts.sky import SkySegmenter
from bench.contracts.stereo import DepthSource
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.evaluation.frame_states import stretches
from bench.evaluation.protocol import Protocol
from bench.prefetch import in_background, prefetch
from bench.runs.atomic import atomic_path
from bench.runs.folder import MAP_FILE, PROVENANCE_FILE, RESOURCES_FILE, RunFolder
from bench.runs.memory import PeakMemory
from bench.runs.provenance import collect_provenance
from bench.types import Keyframe, RenderedView, StereoFrame, TrackingResult, Trajectory

log = logging.getLogger(__name__)

# How far the front end may be ahead of the mapper in pipeline=parallel.
FRAMES_AHEAD = 3

# Called as each frame is done: frames done, frames in all, PSNR of the newest keyframe in dB (NaN before the first).
Progress = Callable[[int, int, float], None]


@dataclass
class System:
    """The parts of one run, built from its config. Building checks everything that can be checked before running."""

    dataset: Dataset
    tracker: Tracker
    keyframer: Keyframer
    stereo: DepthSource
    sky: SkySegmenter
    mapper: Mapper
    protocol: Protocol

    @classmethod
    def build(cls, config: RunConfig) -> System:
        """Construct every plugin; raises ``BenchError`` for bad settings or bad data, before anything is written."""
        dataset = registry.build(config.plugin("dataset"), "dataset")
        parts = {
            kind: registry.build(config.plugin(kind), kind)
            for kind in ("tracker", "keyframer", "stereo", "sky", "mapper")
        }
        losses = [registry.build(loss, "loss") for loss in config.several("loss")]
        rasterizer = registry.build(config.plugin("rasterizer"), "rasterizer")
        for evaluator in config.several("evaluator"):
            registry.lookup("evaluator", evaluator.name)
        parts["stereo"] = cached_depth_source(parts["stereo"], config.plugin("stereo"), dataset, config.cache)
        parts["sky"] = cached_segmenter(parts["sky"], config.plugin("sky"), dataset, config.cache)
        parts["tracker"].start(dataset)
        parts["stereo"].start(dataset)
        parts["mapper"].start(dataset.camera, rasterizer, losses, config.values["seed"])
        return cls(dataset=dataset, protocol=config.protocol, **parts)

    def weights(self) -> dict[str, Path]:
        """The files of network weights in use, as ``"stereo.<what>"`` and ``"sky.<what>"``."""
        parts: dict[str, DepthSource | SkySegmenter] = {"stereo": self.stereo, "sky": self.sky}
        return {f"{kind}.{what}": path for kind, part in parts.items() for what, path in part.weights().items()}


@dataclass
class _Progress:
    """What a run has done so far; saved also when it ends early."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=lambda: {"tracking": 0.0, "stereo": 0.0, "mapping": 0.0})
    psnr_db: float = float("nan")
    started: float = field(default_factory=time.perf_counter)
    wall_s: float | None = None  # of the whole SLAM, before rendering for the evaluation

    def lost_stretches(self) -> list[list[int]]:
        """[first, last] number of every stretch of frames without a pose."""
        lost = np.array([row["state"] == "lost" for row in self.rows], dtype=bool)
        return stretches([row["number"] for row in self.rows], lost)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the wall-clock time of the block to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - start


def run_system(config: RunConfig, progress: Progress | None = None) -> RunFolder:
    """Run the configured system and save the run; returns its folder.

    Raises ``BenchError`` before anything is written for bad input that can be known beforehand. What goes wrong later
    is recorded in ``status.json`` (failed, out_of_memory, interrupted), what was done is saved, and the error goes on.
    """
    torch.manual_seed(config.values["seed"])
    system = System.build(config)
    folder = RunFolder.create(config.output, config.values, config.hash, rerun=config.values["rerun"])
    if folder.already_done:
        return folder
    total, done = len(system.dataset), _Progress()
    memory = PeakMemory()
    with folder.attach_log(), _terminate_as_interrupt():
        folder.set_status("running", frames_total=total)
        try:
            folder.write_json(
                PROVENANCE_FILE, collect_provenance(config.values, config.values["seed"], system.weights())
            )
            _run_frames(system, done, config.values["pipeline"] == "parallel", progress)
            with done.timed("mapping"):
                system.mapper.update_poses(system.tracker.trajectory())
                system.mapper.finish()
            done.wall_s = time.perf_counter() - done.started
            _save_views(system, folder)
            _save(system, folder, done, memory)
            folder.set_status("done", frames_done=len(done.rows), frames_total=total, lost=done.lost_stretches())
        except BaseException as error:
            state, reason = _how_it_ended(error)
            log.exception("The run ended early: %s", reason)
            try:
                _save(system, folder, done, memory)
            except Exception:
                # What ended the run is what the user must hear of; that it broke the saving too is in the log.
                log.exception("What was done could not all be saved")
            finally:
                folder.set_status(state, reason, len(done.rows), total, done.lost_stretches())
            raise
    return folder


@dataclass(frozen=True)
class _FrontEnd:
    """What the front end says about one frame; ``keyframe`` and the poses of that moment for a keyframe only."""

    row: dict[str, Any]
    keyframe: Keyframe | None = None
    window: tuple[int, ...] = ()
    trajectory: Trajectory | None = None


def _run_frames(system: System, done: _Progress, parallel: bool, progress: Progress | None) -> None:
    frames = _front_end(system)
    # Closed at once when mapping fails: the front end must not go on while what was done is being saved.
    with closing(in_background(frames, FRAMES_AHEAD, "bgs-front-end") if parallel else frames) as stream:
        for seen in stream:
            row = seen.row
            done.seconds["tracking"] += row["tracking_s"]
            done.seconds["stereo"] += row["stereo_s"]
            mapping_before = done.seconds["mapping"]
            if seen.keyframe is not None:
                row |= _map_keyframe(system, done, seen)
            row["mapping_s"] = done.seconds["mapping"] - mapping_before
            done.rows.append(row)
            if progress is not None:
                progress(len(done.rows), len(system.dataset), done.psnr_db)


def _front_end(system: System) -> Generator[_FrontEnd, None, None]:
    """Tracking, keyframing, stereo and sky of every frame, in order."""
    camera = system.dataset.camera
    for position, frame in prefetch(system.dataset):
        start = time.perf_counter()
        tracking = _checked(system.tracker.track(frame), frame, system.tracker)
        row: dict[str, Any] = {
            "number": frame.number,
            "timestamp": frame.timestamp,
            "state": tracking.state,
            "inliers": tracking.inliers,
            "reprojection_px": tracking.reprojection_px,
            "is_keyframe": False,
            "mapped": False,
            "heldout": system.protocol.is_held_out(frame.number),
            "tracking_s": time.perf_counter() - start,
            "stereo_s": 0.0,
            "stereo_cached": False,
        }
        if tracking.state == "lost":
            log.warning("frame %d: tracking is lost", frame.number)
        if tracking.state == "lost" or row["heldout"]:
            yield _FrontEnd(row)
            continue
        decision = system.keyframer.update(frame, tracking)
        row["keyframe_reason"] = decision.reason
        row["is_keyframe"] = decision.is_keyframe
        if not (decision.is_keyframe and system.mapper.wants_keyframes):
            yield _FrontEnd(row)
            continue
        start = time.perf_counter()
        depth = system.stereo.depth(frame, position, camera)
        depth_cost = cost_of(system.stereo, time.perf_counter() - start)
        start = time.perf_counter()
        sky = system.sky.segment(frame.left, depth, camera)
        sky_cost = cost_of(system.sky, time.perf_counter() - start)
        row["stereo_s"] = depth_cost.seconds + sky_cost.seconds
        row["stereo_cached"] = depth_cost.cached or sky_cost.cached
        trajectory = system.tracker.trajectory()
        pose = trajectory.pose_of(frame.number)
        assert pose is not None
        yield _FrontEnd(row, Keyframe(frame, depth, sky, pose), decision.window, trajectory)


def _checked(tracking: TrackingResult, frame: StereoFrame, tracker: Tracker) -> TrackingResult:
    """The tracker's answer, if it is one; raises ``BenchError`` that says what was wrong with it."""
    pose = tracking.T_world_cam
    lost = tracking.state == "lost"
    if lost != (pose is None) or (pose is not None and (np.shape(pose) != (4, 4) or not np.isfinite(pose).all())):
        got = "None" if pose is None else f"shape {np.shape(pose)}" + ("" if np.isfinite(pose).all() else " with NaN")
        raise BenchError(
            f"{type(tracker).__name__}.track returned state '{tracking.state}' with a pose of {got} for frame "
            f"{frame.number}; expected a finite 4x4 pose, or None with state 'lost'."
        )
    return tracking


def _map_keyframe(system: System, done: _Progress, seen: _FrontEnd) -> dict[str, Any]:
    """Let the mapper learn from a keyframe; returns its cells of ``frames.csv``."""
    assert seen.keyframe is not None
    assert seen.trajectory is not None
    with done.timed("mapping"):
        system.mapper.update_poses(seen.trajectory)
        report = system.mapper.add_keyframe(seen.keyframe, seen.window)
    done.psnr_db = report.psnr_db
    log.info(
        "frame %d: keyframe (%s), %d Gaussians, %.2f dB, %s",
        *(seen.keyframe.frame.number, seen.row["keyframe_reason"], report.gaussians, report.psnr_db),
        ", ".join(f"{name} {value:.4f}" for name, value in report.losses.items()),
    )
    return {
        "mapped": True,
        "psnr_while_mapping": report.psnr_db,
        "gaussians": report.gaussians,
    }


def _save_views(system: System, folder: RunFolder) -> None:
    """Render every tracked frame from its final pose, left and (if the protocol asks) right, and save it."""
    if not system.mapper.wants_keyframes:
        return
    camera = system.dataset.camera
    trajectory = system.tracker.trajectory()
    for number, T_world_cam in zip(trajectory.numbers.tolist(), trajectory.T_world_cam, strict=True):
        left = system.mapper.render(PinholeView.of(camera, T_world_cam))
        folder.write_view("left", number, left, _depth_to_save(left, system.protocol))
        if system.protocol.right_view:
            right = system.mapper.render(PinholeView.of(camera, T_world_cam @ camera.T_left_right))
            folder.write_view("right", number, right, _depth_to_save(right, system.protocol))


def _depth_to_save(view: RenderedView, protocol: Protocol) -> np.ndarray:
    if protocol.rendered_depth == "raw":
        return view.depth
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(view.alpha > 1e-3, view.depth / view.alpha, np.nan).astype(np.float32)


def _save(system: System, folder: RunFolder, done: _Progress, memory: PeakMemory) -> None:
    """Everything but the renders; what there is of it, when the run ended early."""
    frames = max(len(done.rows), 1)
    folder.write_frames(done.rows)
    folder.write_trajectory(_trajectory_so_far(system.tracker, done), _ground_truth_so_far(system.dataset, done))
    if system.mapper.gaussians:
        with atomic_path(folder.path / MAP_FILE) as temporary:
            system.mapper.save(temporary)
    per_frame = {f"{stage}_s_per_frame": seconds / frames for stage, seconds in done.seconds.items()}
    folder.write_json(
        RESOURCES_FILE,
        {"peak_memory_gb": memory.peak_gb(), "gaussians": system.mapper.gaussians, "frames": len(done.rows)}
        | {"stereo_cached_frames": sum(row["stereo_cached"] for row in done.rows)}
        | per_frame
        | {"wall_s_per_frame": None if done.wall_s is None else done.wall_s / frames},
    )


def _trajectory_so_far(tracker: Tracker, done: _Progress) -> Trajectory:
    """The poses of the frames that are done; the front end of an interrupted run may have been ahead of them."""
    trajectory = tracker.trajectory()
    keep = np.isin(trajectory.numbers, [row["number"] for row in done.rows])
    return Trajectory(trajectory.T_world_cam[keep], trajectory.numbers[keep], trajectory.timestamps[keep])


def _ground_truth_so_far(dataset: Dataset, done: _Progress) -> Trajectory | None:
    truth = dataset.ground_truth()
    if truth is None:
        return None
    n = len(done.rows)
    return Trajectory(truth.T_world_cam[:n], truth.numbers[:n], truth.timestamps[:n])


# How torch's and OpenCV's own errors on the CPU speak of it.
_MEMORY_WORDS = ("can't allocate memory", "Insufficient memory")


def _how_it_ended(error: BaseException) -> tuple[str, str]:
    """State and reason for ``status.json``."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", "stopped by the user"
    text = str(error) or type(error).__name__
    if isinstance(error, MemoryError | torch.OutOfMemoryError) or any(words in text for words in _MEMORY_WORDS):
        return "out_of_memory", text.split("\n", 1)[0]
    return "failed", text if isinstance(error, BenchError) else f"{type(error).__name__}: {text}"


@contextmanager
def _terminate_as_interrupt() -> Iterator[None]:
    """A polite kill (SIGTERM) ends a run like Ctrl-C: what was done is saved."""

    def interrupt(signum: int, frame: Any) -> None:
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:  # not in the main thread, where signals can't be handled
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
