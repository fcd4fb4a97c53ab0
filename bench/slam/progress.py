"""What a run has done so far."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from bench.runs.checkpoint import Snapshot
from bench.runs.events import tell
from bench.runs.memory import PeakMemory
from bench.types import Event, Float


@dataclass
class _Counted:
    """What is told of the rows and events so far while the run goes on; each of them is looked at once."""

    rows: int = 0
    mapped: int = 0
    lost: list[list[int]] = field(default_factory=list)
    events: int = 0
    texts: list[str] = field(default_factory=list)
    blind: list[Event] = field(default_factory=list)

    def look_at(self, rows: Sequence[dict[str, Any]], events: Sequence[Event]) -> None:
        """The new ones of them."""
        for at in range(self.rows, len(rows)):
            number, lost = rows[at]["number"], rows[at]["state"] == "lost"
            self.mapped += bool(rows[at]["mapped"])
            if lost and at and rows[at - 1]["state"] == "lost":
                self.lost[-1][1] = number
            elif lost:
                self.lost.append([number, number])
        for at in range(self.events, len(events)):
            if events[at].kind == "warning":
                self.texts.append(str(events[at].values["text"]))
            elif events[at].kind == "no_depth":
                self.blind.append(events[at])
        self.rows, self.events = len(rows), len(events)


@dataclass
class Progress:
    """What a run has done so far; saved also when it ends early."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=lambda: {"tracking": 0.0, "stereo": 0.0, "mapping": 0.0})
    events: list[Event] = field(default_factory=list)
    psnr_db: float = float("nan")
    keyframe_poses: list[Float] = field(default_factory=list)
    """The pose (4, 4) that each mapped keyframe had when it came, in order."""
    optimised: bool = False
    """The last optimisation is over: map and trajectory stay as they are."""
    started: float = field(default_factory=time.perf_counter)
    wall_s: float | None = None  # of the whole SLAM, before rendering for the evaluation
    before: Snapshot | None = None  # where a resumed run began
    _counted: _Counted = field(default_factory=_Counted)

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
        counted = self._up_to_now()
        if not counted.blind:
            return list(counted.texts)
        source, first = counted.blind[0].values["source"], counted.blind[0].frame
        where = f"in {len(counted.blind)} of {counted.mapped} keyframes, frame {first} first"
        return [*counted.texts, f"{source} knew no depth at all {where}"]

    def resume_from(self, snapshot: Snapshot) -> None:
        """Take over what was done before the break; the clock starts now."""
        self.rows = list(snapshot.rows)
        self.events = list(snapshot.events)
        self.seconds = dict(snapshot.seconds)
        self.psnr_db = snapshot.psnr_db
        self.keyframe_poses = list(snapshot.keyframe_poses)
        self.optimised = snapshot.optimised
        self.before, self._counted = snapshot, _Counted()
        self.started = time.perf_counter()

    def lost_stretches(self) -> list[list[int]]:
        """[first, last] number of every stretch of frames without a pose."""
        return [list(stretch) for stretch in self._up_to_now().lost]

    def _up_to_now(self) -> _Counted:
        self._counted.look_at(self.rows, self.events)
        return self._counted

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the wall-clock time of the block to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - start
