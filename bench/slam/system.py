"""The SLAM loop: the one place where the stages meet.

Data flows one way: data set -> tracker -> keyframer -> stereo -> sky -> mapper -> run folder. Scoring comes afterwards
and reads the run folder only. The part before the mapper (the front end) never looks at the map, so it may run ahead
in a thread of its own (``pipeline=parallel``) without changing a single bit of the result.
"""

from __future__ import annotations

import json
import logging
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from bench import _native, registry
from bench.cache import cached_depth_source, cached_segmenter, cached_tracker
from bench.config import RunConfig
from bench.contracts.dataset import Dataset
from bench.contracts.keyframer import Keyframer
from bench.contracts.mapper import Mapper
from bench.contracts.sky import SkySegmenter
from bench.contracts.stereo import DepthSource
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.plugin_config import plugins_in
from bench.protocol import Protocol
from bench.runs.checkpoint import Checkpoints, Snapshot
from bench.runs.events import check_events
from bench.runs.fingerprint import fingerprint
from bench.runs.folder import PROVENANCE_FILE, RunFolder
from bench.runs.memory import PeakMemory
from bench.runs.memory_limit import MemoryLimit
from bench.runs.provenance import collect_provenance
from bench.slam.front_end import Seen, front_end
from bench.slam.outputs import Done, save_outputs, save_views
from bench.slam.prefetch import in_background
from bench.types import Event, Keyframe

log = logging.getLogger(__name__)

# How far the front end may be ahead of the mapper in pipeline=parallel.
FRAMES_AHEAD = 3

# What the front end must say again, to the bit, when a run is gone on with.
_REPEATED = ("number", "state", "inliers", "reprojection_px", "heldout", "is_keyframe", "keyframe_reason")
_END: Any = object()

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
        _native.set_threads(config.values["threads"] or torch.get_num_threads())
        dataset = registry.build(config.plugin("dataset"), "dataset")
        parts = {
            kind: registry.build(config.plugin(kind), kind)
            for kind in ("tracker", "keyframer", "stereo", "sky", "mapper")
        }
        losses = [registry.build(loss, "loss") for loss in config.several("loss")]
        for evaluator in config.several("evaluator"):
            registry.lookup("evaluator", evaluator.name)
        parts["stereo"] = cached_depth_source(parts["stereo"], config.plugin("stereo"), dataset, config.cache)
        parts["sky"] = cached_segmenter(parts["sky"], config.plugin("sky"), dataset, config.cache)
        parts["tracker"] = cached_tracker(
            parts["tracker"], config.plugin("tracker"), config.values["dataset"], config.cache
        )
        parts["tracker"].start(dataset)
        parts["stereo"].start(dataset)
        parts["mapper"].start(dataset.camera, losses, config.values["seed"])
        return cls(dataset=dataset, protocol=config.protocol, **parts)

    def weights(self) -> dict[str, Path]:
        """The files of network weights in use, as ``"stereo.<what>"`` and ``"sky.<what>"``."""
        parts: dict[str, DepthSource | SkySegmenter] = {"stereo": self.stereo, "sky": self.sky}
        return {f"{kind}.{what}": path for kind, part in parts.items() for what, path in part.weights().items()}


def run_system(config: RunConfig, progress: Progress | None = None) -> RunFolder:
    """Run the configured system and save the run; returns its folder.

    A run that was stopped or killed goes on from its last checkpoint (``resume``), if nothing that its result depends
    on has changed since. Raises ``BenchError`` before anything is written for bad input that can be known beforehand.
    What goes wrong later is recorded in ``status.json`` (failed, out_of_memory, interrupted), what was done is saved,
    and the error goes on.
    """
    values = config.values
    system = System.build(config)
    going_on = values["resume"] and not values["rerun"]
    folder = RunFolder.create(
        config.output, values, config.hash, values["rerun"], keep_log=going_on, map_file=system.mapper.map_file
    )
    if folder.already_done:
        system.tracker.finish()
        return folder
    checkpoints = Checkpoints(folder.path, _fingerprint(config, system), values["checkpoint_s"])
    if not going_on:
        checkpoints.remove()
    run = _Run(config, system, folder, checkpoints, MemoryLimit(config.limits.memory_gb), progress)
    with folder.attach_log(), _terminate_as_interrupt():
        folder.set_status("running", frames_total=run.total, stage="mapping")
        try:
            with run.limit.watching():
                run.make()
        except BaseException as error:
            state, reason = _how_it_ended(error)
            log.exception("The run ended early: %s", reason)
            try:
                run.finish_tracking()
                save_outputs(run.system, folder, run.done, run.memory)
            except Exception:
                # What ended the run is what the user must hear of; that it broke the saving too is in the log.
                log.exception("What was done could not all be saved")
            finally:
                folder.set_status(state, reason, len(run.done.rows), run.total, run.done.lost_stretches())
            raise
        folder.set_status(
            "done", frames_done=len(run.done.rows), frames_total=run.total, lost=run.done.lost_stretches()
        )
    checkpoints.remove()
    return folder


def _fingerprint(config: RunConfig, system: System) -> str:
    """What a checkpoint of this run must have been made with."""
    used = [registry.lookup(kind, part["name"]) for kind, part in plugins_in(config.values) if kind != "evaluator"]
    return fingerprint(config.hash, [plugin.cls for plugin in used], system.weights())


class ReplayDiffersError(Exception):
    """The front end says something else of a frame than it did before the break."""


@dataclass
class _Run:
    """A run under way: its parts, its folder, and what it has done so far."""

    config: RunConfig
    system: System
    folder: RunFolder
    checkpoints: Checkpoints
    limit: MemoryLimit
    progress: Progress | None
    done: Done = field(default_factory=Done)
    memory: PeakMemory = field(default_factory=PeakMemory)
    _tracking: bool = True

    @property
    def total(self) -> int:
        return len(self.system.dataset)

    def make(self) -> None:
        """Map all frames, from the checkpoint on if there is one, and save everything."""
        snapshot = self.checkpoints.load()
        try:
            self._map_frames(snapshot)
        except ReplayDiffersError as error:
            log.warning("%s; the run begins anew. Is a plugin not deterministic?", error)
            self.checkpoints.remove()
            self.finish_tracking()
            self.system, self.done, self._tracking = System.build(self.config), Done(), True
            self._map_frames(None)
        self.finish_tracking()
        self._optimise_at_the_end()
        self.done.wall_s = self.done.elapsed_s()
        self._tell("rendering", now=True)
        save_views(self.system, self.folder)
        save_outputs(self.system, self.folder, self.done, self.memory)

    def finish_tracking(self) -> None:
        """Tell the tracker, once, that no frame follows."""
        if self._tracking:
            self._tracking = False
            self.system.tracker.finish()

    def _map_frames(self, snapshot: Snapshot | None) -> None:
        values = self.config.values
        torch.manual_seed(values["seed"])
        provenance = collect_provenance(values, values["seed"], self.system.weights())
        frames = front_end(self.system)
        # Closed at once when mapping fails: the front end must not go on while what was done is being saved.
        parallel = values["pipeline"] == "parallel"
        with closing(in_background(frames, FRAMES_AHEAD, "bgs-front-end") if parallel else frames) as stream:
            if snapshot is not None:
                self._go_on_from(snapshot, stream)
            resumed = {"resumed_after_frames": self.done.resumed_after()}
            self.folder.write_json(PROVENANCE_FILE, provenance | (resumed if snapshot is not None else {}))
            for seen in stream:
                self._take(seen)
                self._after_a_step("mapping")
                if self.progress is not None:
                    self.progress(len(self.done.rows), self.total, self.done.psnr_db)

    def _take(self, seen: Seen) -> None:
        """Map a frame, if it is a keyframe, and note what became of it."""
        row, done = seen.row, self.done
        done.seconds["tracking"] += row["tracking_s"]
        done.seconds["stereo"] += row["stereo_s"]
        done.note(seen.events)
        if row["state"] == "lost" and not (done.rows and done.rows[-1]["state"] == "lost"):
            done.note([Event("lost", row["number"])])
        mapping_before = done.seconds["mapping"]
        if seen.keyframe is not None:
            row |= _map_keyframe(self.system, done, seen)
        row["mapping_s"] = done.seconds["mapping"] - mapping_before
        done.rows.append(row)

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

    def _go_on_from(self, snapshot: Snapshot, stream: Iterator[Seen]) -> None:
        """Let the front end repeat the frames of the checkpoint, and give the mapper its state and its keyframes."""
        frames = len(snapshot.rows)
        log.info("going on from the checkpoint after frame %d of %d", frames, self.total)
        keyframes = self._repeated(snapshot.rows, stream)
        self.system.mapper.restore(snapshot.mapper, keyframes)
        deque(keyframes, maxlen=0)  # those that the mapper had no use for: the front end must get past them
        torch.set_rng_state(snapshot.random)
        self.done.go_on_from(snapshot)

    def _repeated(self, rows: list[dict[str, Any]], stream: Iterator[Seen]) -> Iterator[Keyframe]:
        """The keyframes of the frames in ``rows``; raises ``ReplayDiffersError`` where the front end says otherwise."""
        for count, row in enumerate(rows, 1):
            seen = next(stream, None)
            now = None if seen is None else {key: seen.row.get(key) for key in _REPEATED}
            if not _same(now, {key: row.get(key) for key in _REPEATED}):
                raise ReplayDiffersError(f"tracking frame {row['number']} again gives another result than before")
            self.limit.check()
            if self.progress is not None:
                self.progress(count, self.total, float("nan"))
            if seen is not None and seen.keyframe is not None:
                yield seen.keyframe

    def _after_a_step(self, stage: str) -> None:
        """What is due between two steps of mapping."""
        self.limit.check()
        self._tell(stage)
        self.checkpoints.if_due(self._snapshot)

    def _tell(self, stage: str, now: bool = False) -> None:
        if now:
            self.folder.set_status("running", "", len(self.done.rows), self.total, stage=stage)
        else:
            self.folder.tell_progress(len(self.done.rows), self.total, stage)

    def _snapshot(self) -> Snapshot | None:
        state = self.system.mapper.state()
        if state is None:
            return None
        done = self.done
        return Snapshot(
            rows=done.rows,
            mapper=state,
            seconds=done.seconds,
            elapsed_s=done.elapsed_s(),
            psnr_db=done.psnr_db,
            peak_memory_gb=done.peak_memory_gb(self.memory),
            random=torch.get_rng_state(),
            resumed_after=done.resumed_after(),
            events=[asdict(event) for event in done.events],
        )


def _same(one: object, other: object) -> bool:
    """Whether two rows are equal to the bit; NaN equals NaN, and numpy's numbers equal Python's."""
    first, second = (json.dumps(row, default=lambda number: number.item()) for row in (one, other))
    return first == second


def _note_of_mapper(system: System, done: Done, events: Sequence[Event]) -> None:
    check_events(events, type(system.mapper).__name__)
    done.note(events)


def _map_keyframe(system: System, done: Done, seen: Seen) -> dict[str, Any]:
    """Let the mapper learn from a keyframe; returns its cells of ``frames.csv``."""
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
    return {
        "mapped": True,
        "psnr_while_mapping": report.psnr_db,
        **size,
    }


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
