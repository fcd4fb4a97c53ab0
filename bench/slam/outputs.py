"""What a run has done, and how it is saved: frames, trajectory, map, resources, renders."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.evaluation.frame_states import stretches
from bench.io.atomic import atomic_path
from bench.protocol import Protocol
from bench.runs.checkpoint import Snapshot
from bench.runs.events import tell
from bench.runs.folder import RESOURCES_FILE, RunFolder
from bench.runs.memory import PeakMemory
from bench.types import Event, PinholeView, RenderedView, Trajectory

if TYPE_CHECKING:
    from bench.slam.system import System


@dataclass
class Done:
    """What a run has done so far; saved also when it ends early."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=lambda: {"tracking": 0.0, "stereo": 0.0, "mapping": 0.0})
    events: list[Event] = field(default_factory=list)
    psnr_db: float = float("nan")
    started: float = field(default_factory=time.perf_counter)
    wall_s: float | None = None  # of the whole SLAM, before rendering for the evaluation
    before: Snapshot | None = None  # where a resumed run began

    def elapsed_s(self) -> float:
        """Wall time until now, that of a resumed run before its break included."""
        before = 0.0 if self.before is None else self.before.elapsed_s
        return before + time.perf_counter() - self.started

    def peak_memory_gb(self, memory: PeakMemory) -> float:
        """Peak memory, before the break too."""
        return max(memory.peak_gb(), 0.0 if self.before is None else self.before.peak_memory_gb)

    def resumed_after(self) -> list[int]:
        """Numbers of frames after which the run was gone on with."""
        return [] if self.before is None else [*self.before.resumed_after, len(self.before.rows)]

    def note(self, events: Sequence[Event]) -> None:
        """What just happened, which also goes to the log."""
        for event in events:
            tell(event)
        self.events += events

    def go_on_from(self, snapshot: Snapshot) -> None:
        """Take over what was done before the break; the clock starts now."""
        self.rows = list(snapshot.rows)
        self.events = [Event(**event) for event in snapshot.events]
        self.seconds = dict(snapshot.seconds)
        self.psnr_db = snapshot.psnr_db
        self.before = snapshot
        self.started = time.perf_counter()

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


def save_views(system: System, folder: RunFolder) -> None:
    """Render every tracked frame from its final pose, left and (if the protocol asks) right, and save it."""
    if not system.mapper.wants_keyframes:
        return
    camera = system.dataset.camera
    trajectory = system.tracker.trajectory()
    for number, T_world_cam in zip(trajectory.numbers.tolist(), trajectory.T_world_cam, strict=True):
        left = system.mapper.render(PinholeView.of(camera, T_world_cam))
        folder.write_view("left", number, left, _depth_to_save(left, system.protocol))
        if system.protocol.right_view and system.dataset.has_right:
            right = system.mapper.render(PinholeView.of(camera, T_world_cam @ camera.T_left_right))
            folder.write_view("right", number, right, _depth_to_save(right, system.protocol))


def _depth_to_save(view: RenderedView, protocol: Protocol) -> np.ndarray:
    if protocol.rendered_depth == "raw":
        return view.depth
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(view.alpha > 1e-3, view.depth / view.alpha, np.nan).astype(np.float32)


def save_outputs(system: System, folder: RunFolder, done: Done, memory: PeakMemory) -> None:
    """Everything but the renders; what there is of it, when the run ended early."""
    frames = max(len(done.rows), 1)
    folder.write_frames(done.rows)
    folder.write_events(done.events)
    folder.write_trajectory(_trajectory_so_far(system.tracker, done), _ground_truth_so_far(system.dataset, done))
    size = system.mapper.size()
    if system.mapper.map_file is not None and _holds_something(size, done):
        with atomic_path(folder.path / system.mapper.map_file) as temporary:
            system.mapper.save(temporary)
    per_frame = {f"{stage}_s_per_frame": seconds / frames for stage, seconds in done.seconds.items()}
    folder.write_json(
        RESOURCES_FILE,
        {"peak_memory_gb": done.peak_memory_gb(memory), **size, "frames": len(done.rows)}
        | {f"{what}_cached_frames": sum(row[f"{what}_cached"] for row in done.rows) for what in ("tracking", "stereo")}
        | per_frame
        | {"wall_s_per_frame": None if done.wall_s is None else done.wall_s / frames},
    )


def _holds_something(size: dict[str, int], done: Done) -> bool:
    """Whether there is a map to save: an empty one, after a failure in the first keyframe, is none."""
    return any(size.values()) if size else any(row["mapped"] for row in done.rows)


def _trajectory_so_far(tracker: Tracker, done: Done) -> Trajectory:
    """The poses of the frames that are done; the front end of an interrupted run may have been ahead of them."""
    trajectory = tracker.trajectory()
    keep = np.isin(trajectory.numbers, [row["number"] for row in done.rows])
    return Trajectory(trajectory.T_world_cam[keep], trajectory.numbers[keep], trajectory.timestamps[keep])


def _ground_truth_so_far(dataset: Dataset, done: Done) -> Trajectory | None:
    truth = dataset.ground_truth()
    if truth is None:
        return None
    n = len(done.rows)
    return Trajectory(truth.T_world_cam[:n], truth.numbers[:n], truth.timestamps[:n])
