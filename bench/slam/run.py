"""The SLAM loop: the one place where the stages meet.

Data flows one way: data set -> tracker -> keyframer -> stereo -> sky -> mapper -> run folder. Scoring comes afterwards
and reads the run folder only. The part before the mapper (the front end) may run ahead in a thread of its own
(``pipeline=parallel``) without changing a single bit of the result, unless a tracker or keyframer looks at the map.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from bench.config import RunConfig
from bench.errors import BenchError
from bench.machine import matrix_product_ms
from bench.runs.checkpoint import Checkpoints, Snapshot
from bench.runs.endings import how_it_ended, terminate_as_interrupt
from bench.runs.events import check_events
from bench.runs.folder import PROVENANCE_FILE, RunFolder
from bench.runs.memory import PeakMemory
from bench.runs.provenance import collect_provenance
from bench.runs.status import RunStatus
from bench.runs.watchdog import TimeLimitError, Watchdog, stacks_of_threads
from bench.slam.checkpointing import CannotResumeError, repeat, restore, snapshot_of, states_of_front_end
from bench.slam.front_end import Seen, front_end
from bench.slam.observers import Observers
from bench.slam.outputs import save_outputs, save_views
from bench.slam.prefetch import in_background
from bench.slam.progress import Progress
from bench.slam.system import System, fingerprint_of
from bench.tracking.pair_check import PairCheck
from bench.types import UNCONFIRMED, Event

log = logging.getLogger(__name__)

# How far the front end may be ahead of the mapper in pipeline=parallel.
FRAMES_AHEAD = 3

_END: Any = object()

# Called as each frame is done: frames done, frames in all, PSNR of the newest keyframe in dB (NaN before the first).
Tell = Callable[[int, int, float], None]


# Called with the parts of a run that is about to begin, before anything is written.
Foresee = Callable[[System], None]


def run_system(
    config: RunConfig,
    progress: Tell | None = None,
    watchdog: Watchdog | None = None,
    foresee: Foresee | None = None,
    observers: Observers | None = None,
) -> RunFolder:
    """Run the configured system and save the run; returns its folder.

    A run that was stopped or killed is resumed from its last checkpoint (``resume``), if nothing that its result
    depends on has changed since. Raises ``BenchError`` before anything is written for bad input that can be known
    beforehand. What goes wrong later is recorded in ``status.json`` (failed, out_of_memory, interrupted), what was done
    is saved, and the error goes on. ``watchdog`` is one that watches more than this, and ``observers`` are those of the
    config for who goes on telling them, or ends them; by default they follow this alone.
    """
    watchdog = watchdog or Watchdog(config.limits)
    with watchdog.watching(), Observers.of(config) if observers is None else nullcontext(observers) as following:
        return _run_system(config, progress, watchdog, foresee, following)


def _run_system(
    config: RunConfig, progress: Tell | None, watchdog: Watchdog, foresee: Foresee | None, observers: Observers
) -> RunFolder:
    values = config.values
    system = System.build(config)
    if foresee is not None:
        foresee(system)
    resuming = values["resume"] and not values["rerun"]
    folder = RunFolder.create(
        config.output, values, config.hash, values["rerun"], to_resume=resuming, map_file=system.mapper.map_file
    )
    if folder.already_done:
        system.tracker.finish()
        return folder
    checkpoints = Checkpoints(folder.path, fingerprint_of(config, system), values["checkpoint_s"])
    if not resuming:
        checkpoints.remove()
    run = _Run(config, system, folder, checkpoints, watchdog, progress, observers)
    with folder.attach_log(), terminate_as_interrupt():
        folder.set_status("running", frames_total=run.total, stage="mapping")
        watchdog.begin(run.failed_status)
        try:
            run.make()
        except BaseException as error:
            watchdog.stand_down()
            run.save_what_was_done(error)
            raise
        folder.set_status(
            "done", frames_done=len(run.done.rows), frames_total=run.total, lost=run.done.lost_stretches()
        )
    checkpoints.remove()
    return folder


@dataclass
class _Run:
    """A run under way: its parts, its folder, and what it has done so far."""

    config: RunConfig
    system: System
    folder: RunFolder
    checkpoints: Checkpoints
    watchdog: Watchdog
    progress: Tell | None
    observers: Observers
    done: Progress = field(default_factory=Progress)
    memory: PeakMemory = field(default_factory=PeakMemory)
    _tracking: bool = True

    @property
    def total(self) -> int:
        return len(self.system.dataset)

    def make(self) -> None:
        """Map all frames, from the checkpoint on if there is one, and save everything."""
        snapshot = self.checkpoints.load()
        if snapshot is None or not snapshot.optimised:
            self.folder.remove_views()
        try:
            self._map_frames(snapshot)
        except CannotResumeError as error:
            log.warning("the run begins anew: %s", error)
            self.checkpoints.remove()
            self.folder.remove_views()
            self.finish_tracking()
            self.system, self.done, self._tracking = System.build(self.config), Progress(), True
            self._map_frames(None)
        self.finish_tracking()
        self._require_tracked()
        if not self.done.optimised:
            self._optimise_at_the_end()
            self.observers.optimised(self.system)
            self.done.optimised = True
            # From here on views are written, and whoever resumes from this checkpoint can trust those that it finds.
            if self.checkpoints.due(at_once=True):
                self._write_checkpoint(None)
        self.done.wall_s = self.done.elapsed_s()
        self._tell("rendering", now=True)
        save_views(self.system, self.folder, self.done, self.watchdog.step)
        save_outputs(self.system, self.folder, self.done, self.memory)

    def finish_tracking(self) -> None:
        """Tell the tracker, once, that no frame follows."""
        if self._tracking:
            self._tracking = False
            self.system.tracker.finish()

    def save_what_was_done(self, error: BaseException) -> None:
        """After what ended the run early; the status says why."""
        state, reason = how_it_ended(error)
        log.exception("The run ended early: %s", reason)
        if isinstance(error, TimeLimitError):
            log.error("Where its threads are:\n%s", stacks_of_threads())
        try:
            self.finish_tracking()
            save_outputs(self.system, self.folder, self.done, self.memory)
        except (Exception, SystemExit):
            # What ended the run is what the user must hear of; that it broke the saving too is in the log.
            log.exception("What was done could not all be saved")
        finally:
            self.folder.set_status(state, reason, len(self.done.rows), self.total, self.done.lost_stretches())

    def failed_status(self, reason: str) -> tuple[Path, RunStatus]:
        """The run folder, and what its status would say if the run ended now."""
        frames, lost = len(self.done.rows), self.done.lost_stretches()
        return self.folder.path, self.folder.status_now("failed", reason, frames, self.total, lost)

    def _map_frames(self, snapshot: Snapshot | None) -> None:
        values = self.config.values
        torch.manual_seed(values["seed"])
        provenance = collect_provenance(values, values["seed"], self.system.weights())
        provenance["machine"]["mm_ms"] = round(matrix_product_ms(), 1)
        self.system.mapper.use_store(self.checkpoints.stores["mapper"])
        self.system.tracker.use_store(self.checkpoints.stores["tracker"])
        check, first = PairCheck(self.system.dataset), 0
        if snapshot is not None:
            log.info("resumed from the checkpoint after frame %d of %d", len(snapshot.rows), self.total)
            if snapshot.seeing:
                restore(self.system, snapshot, check, self._repeated)
                first = len(snapshot.rows)
        frames = front_end(
            self.system, check, lambda pairs: states_of_front_end(self.system, self.checkpoints, pairs), first
        )
        if self.system.in_step:
            log.info("pipeline: in step, one frame at a time, since tracker or keyframer look at the map")
        ahead = values["pipeline"] == "parallel" and not self.system.in_step
        # Closed at once when mapping fails: the front end must not go on while what was done is being saved.
        with closing(in_background(frames, FRAMES_AHEAD, "bgs-front-end") if ahead else frames) as stream:
            if snapshot is not None:
                if not snapshot.seeing:
                    repeat(self.system, snapshot, stream, self._repeated)
                self.done.resume_from(snapshot)
                self.folder.warnings = self.done.warnings()
            resumed = {"resumed_after_frames": self.done.resumed_after()}
            self.folder.write_json(PROVENANCE_FILE, provenance | (resumed if snapshot is not None else {}))
            self.observers.begin(self.folder.path, self.config, self.system, len(self.done.rows))
            for seen in stream:
                self.observers.frame(self.system, seen, self._take(seen))
                self._after_a_step("mapping")
                if seen.states is not None:
                    self._write_checkpoint(seen.states)
                if self.progress is not None:
                    self.progress(len(self.done.rows), self.total, self.done.psnr_db)

    def _take(self, seen: Seen) -> dict[str, float] | None:
        """Map a frame, if it is a keyframe, and note what became of it; the losses of a keyframe."""
        row, done = seen.row, self.done
        done.seconds["tracking"] += row["tracking_s"]
        done.seconds["stereo"] += row["stereo_s"]
        done.note(seen.events)
        state = row["state"]
        if state in UNCONFIRMED and not (done.rows and done.rows[-1]["state"] == state):
            done.note([Event(state, row["number"])])
        mapping_before, losses = done.seconds["mapping"], None
        if seen.keyframe is not None:
            done.keyframe_poses.append(seen.keyframe.T_world_cam.copy())
            cells, losses = _map_keyframe(self.system, done, seen)
            row |= cells
        row["mapping_s"] = done.seconds["mapping"] - mapping_before
        row["memory_gb"] = self.memory.now_gb()
        done.rows.append(row)
        if seen.events:
            self.folder.warnings = done.warnings()
        return losses

    def _require_tracked(self) -> None:
        """Raise ``BenchError`` where tracking never worked: the pose that the world begins at is no trajectory."""
        tracked = sum(row["state"] not in UNCONFIRMED for row in self.done.rows)
        if self.total <= 2 or tracked > 1:
            return
        why = "; ".join(self.done.warnings()) or "See the images, the calibration and log.txt."
        raise BenchError(f"Tracking was lost in {self.total - tracked} of {self.total} frames: there is no run. {why}")

    def _optimise_at_the_end(self) -> None:
        with self.done.timed("mapping"):
            self.system.mapper.update_poses(self.system.tracker.trajectory())
        steps = self.system.mapper.final_steps()
        while True:
            with self.done.timed("mapping"):
                events = next(steps, _END)
            if events is _END:
                return
            _note_of_mapper(self.system, self.done, events or ())
            self._after_a_step("last optimisation")
            if self.checkpoints.due():
                self._write_checkpoint(None)

    def _repeated(self, frames: int) -> None:
        """What is due when another frame before the break is done again."""
        self.watchdog.step()
        if self.progress is not None:
            self.progress(frames, self.total, float("nan"))

    def _after_a_step(self, stage: str) -> None:
        """What is due between two steps of mapping."""
        self.watchdog.step()
        self._tell(stage)

    def _write_checkpoint(self, seeing: dict[str, Any] | None) -> None:
        """``seeing`` is what the front end gave after the newest frame; None once all are tracked."""
        snapshot = snapshot_of(self.system, self.done, self.memory, self.checkpoints, seeing)
        if snapshot is not None:
            self.checkpoints.write(snapshot)

    def _tell(self, stage: str, now: bool = False) -> None:
        if now:
            self.folder.set_status("running", "", len(self.done.rows), self.total, stage=stage)
        else:
            self.folder.tell_progress(len(self.done.rows), self.total, stage)


def _note_of_mapper(system: System, done: Progress, events: Sequence[Event]) -> None:
    check_events(events, type(system.mapper).__name__)
    done.note(events)


def _map_keyframe(system: System, done: Progress, seen: Seen) -> tuple[dict[str, Any], dict[str, float]]:
    """Let the mapper learn from a keyframe; returns its cells of ``frames.csv``, and its losses by name."""
    assert seen.keyframe is not None
    assert seen.trajectory is not None
    with done.timed("mapping"):
        system.mapper.update_poses(seen.trajectory)
        report = system.mapper.add_keyframe(seen.keyframe, seen.window)
    done.psnr_db = report.psnr_db
    _note_of_mapper(system, done, report.events)
    size = system.mapper.size()
    log.info(
        "frame %d: keyframe (%s), %s",
        *(seen.keyframe.frame.number, seen.row["keyframe_reason"]),
        ", ".join(
            [
                *(f"{count} {what}" for what, count in size.items()),
                f"{report.psnr_db:.2f} dB",
                *(f"{name} {value:.4f}" for name, value in report.losses.items()),
            ]
        ),
    )
    cells = {
        "mapped": True,
        "psnr_while_mapping": report.psnr_db,
        **({"right_mapped": True} if system.mapper.uses_right_images else {}),
        **size,
    }
    return cells, report.losses
