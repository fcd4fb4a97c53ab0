"""What a run has done so far."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.evaluation.frame_states import stretches
from bench.runs.checkpoint import Snapshot
from bench.runs.events import tell
from bench.runs.memory import PeakMemory
from bench.types import Event, Float


@dataclass
class Progress:
    """What a run has done so far; saved also when it ends early."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=lambda: {"tracking": 0.0, "stereo": 0.0, "mapping": 0.0})
    events: list[Event] = field(default_factory=list)
    psnr_db: float = float("nan")
    keyframe_poses: dict[int, Float] = field(default_factory=dict)
    """The pose (4, 4) that each mapped keyframe had when it came; of runs that go in step with the map only."""
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
        """Numbers of frames after which the run was resumed."""
        return [] if self.before is None else [*self.before.resumed_after, len(self.before.rows)]

    def note(self, events: Sequence[Event]) -> None:
        """What just happened, which also goes to the log."""
        for event in events:
            tell(event)
        self.events += events

    def warnings(self) -> list[str]:
        """What makes the run's numbers doubtful, a sentence each."""
        found = [str(event.values["text"]) for event in self.events if event.kind == "warning"]
        blind = [event for event in self.events if event.kind == "no_depth"]
        if blind:
            keyframes = sum(row["mapped"] for row in self.rows)
            source, first = blind[0].values["source"], blind[0].frame
            found.append(f"{source} knew no depth at all in {len(blind)} of {keyframes} keyframes, frame {first} first")
        return found

    def resume_from(self, snapshot: Snapshot) -> None:
        """Take over what was done before the break; the clock starts now."""
        self.rows = list(snapshot.rows)
        self.events = [Event(**event) for event in snapshot.events]
        self.seconds = dict(snapshot.seconds)
        self.psnr_db = snapshot.psnr_db
        self.keyframe_poses = {number: pose.numpy() for number, pose in snapshot.keyframe_poses.items()}
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
