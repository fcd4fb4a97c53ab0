"""What a sweep tells while it runs: a line for each event, and in a terminal a live table below them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from bench.errors import BenchError
from bench.plain_text import plain_line
from bench.runs.status import read_status
from bench.sweeps.job import Job, Outcome
from bench.sweeps.lookup import Found
from bench.sweeps.plan import PlannedRun
from bench.sweeps.time_left import RunProgress, seconds_left

_REFRESH_S = 0.5
State = Literal["waiting", "running", "elsewhere", "done", "failed"]
_GLYPHS: dict[State, tuple[str, str]] = {
    "waiting": ("·", "dim"),
    "running": ("▶", "cyan"),
    "elsewhere": ("▷", "yellow"),
    "done": ("✓", "green"),
    "failed": ("✗", "red"),
}


@dataclass
class _Shown:
    """A run as the view knows it; ``who`` says where it runs, if not here."""

    planned: PlannedRun
    state: State = "waiting"
    since: float = 0.0
    seconds: float = 0.0
    frames_done: int = 0
    frames: int = 0
    stage: str = ""
    who: str = ""


@dataclass
class SweepView:
    """Counts and prints. ``at_once`` runs are made at once; 0 = as many as a cluster gives.

    A context manager:
    the live table is there within it, and only where the console is a terminal.
    """

    console: Console
    title: str
    planned: Sequence[PlannedRun]
    at_once: int
    _runs: dict[Path, _Shown] = field(default_factory=dict)
    _told: int = 0
    _to_make: int = 0
    _live: Live | None = None
    _refreshed: float = 0.0

    def __post_init__(self) -> None:
        for planned in self.planned:
            self._runs[planned.job.folder] = _Shown(planned, frames=planned.frames)
        self._to_make = len(self._runs)

    def leave(self, planned: PlannedRun, found: Found) -> None:
        """A run that the sweep leaves as it was found."""
        self._of(planned.job).state = "done" if found.progress == "finished" else "failed"
        self._to_make -= 1

    def __enter__(self) -> SweepView:
        if self.console.is_terminal:
            self._live = Live(console=self.console, get_renderable=self._summary, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.stop()

    def started(self, job: Job, place: str = "") -> None:
        """A run was started, here or at a ``place`` of a cluster."""
        shown = self._of(job)
        shown.state, shown.since, shown.who = "running", time.monotonic(), place
        if self._live is None:
            self._say(f"started{_at(place)}: {job.label}")

    def waits(self, job: Job, who: str) -> None:
        """A run is being made by another process; its end is waited for."""
        shown = self._of(job)
        shown.state, shown.since, shown.who = "elsewhere", time.monotonic(), who
        self._say(f"running elsewhere ({who}): {job.label}", "yellow")

    def ended(self, outcome: Outcome) -> None:
        """A run ended, here or elsewhere, or needs nothing more."""
        shown, label, found = self._of(outcome.job), outcome.job.label, outcome.found
        self._told += 1
        shown.seconds = outcome.seconds
        if found.progress == "finished":
            shown.state = "done"
            made_here = outcome.seconds > 0
            self._say(f"done in {duration(outcome.seconds)}: {label}" if made_here else f"done elsewhere: {label}")
            return
        shown.state = "failed"
        reason = f" ({found.reason})" if found.reason else ""
        self._say(f"{found.progress}: {label}{reason}", "red")

    def refresh(self) -> None:
        """Read how far the runs are and redraw, at most every half second."""
        now = time.monotonic()
        if self._live is None or now - self._refreshed < _REFRESH_S:
            return
        self._refreshed = now
        self.read_progress()
        self._live.refresh()

    def read_progress(self) -> None:
        """Read from the folders of the runs under way, wherever they are made, how many frames they have done."""
        for folder, shown in self._runs.items():
            if shown.state not in ("running", "elsewhere"):
                continue
            try:
                status = read_status(folder)
            except BenchError:
                continue  # the run's outcome will say that it is damaged
            if status is not None and status.state == "running":
                shown.frames_done, shown.frames = status.frames_done, status.frames_total or shown.frames
                shown.stage = status.stage

    def summary_line(self) -> str:
        """How far the sweep is, in a line."""
        counts = {state: sum(shown.state == state for shown in self._runs.values()) for state in _GLYPHS}
        parts = [f"{counts['done']} of {len(self._runs)} done", f"{counts['running']} running"]
        if counts["failed"]:
            parts.append(f"{counts['failed']} failed or stopped")
        if counts["elsewhere"]:
            parts.append(f"{counts['elsewhere']} running elsewhere")
        parts.append(f"{counts['waiting']} waiting")
        left = self.seconds_left()
        return f"{self.title}: {', '.join(parts)}" + ("" if left is None else f"; about {duration(left)} left")

    def seconds_left(self) -> float | None:
        """By the frames of the runs and the times of those that were made; None before anything is known."""
        now = time.monotonic()
        runs, running = [], 0
        for shown in self._runs.values():
            under_way = shown.state in ("running", "elsewhere")
            running += under_way
            spent = now - shown.since if under_way else shown.seconds
            states: dict[State, Literal["waiting", "running", "finished", "gone"]] = {
                "waiting": "waiting",
                "running": "running",
                "elsewhere": "running",
                "done": "finished",
                "failed": "gone",
            }
            state = states[shown.state]
            runs.append(RunProgress(shown.planned.cell.row, state, shown.frames, shown.frames_done, spent))
        return seconds_left(runs, self.at_once or running)

    def _of(self, job: Job) -> _Shown:
        return self._runs[job.folder]

    def _summary(self) -> RenderableType:
        now = time.monotonic()
        parts: list[RenderableType] = [Text(self.summary_line(), style="bold")]
        rows = {shown.planned.cell.row for shown in self._runs.values()}
        if len(rows) > 1 and len(rows) <= self.console.height - 6:
            parts.append(self._cells())
        under_way = [shown for shown in self._runs.values() if shown.state in ("running", "elsewhere")]
        for shown in under_way[: max(self.console.height - 8 - len(rows), 4)]:
            frames = f"frame {shown.frames_done}/{shown.frames}, " if shown.frames else ""
            stage = f"{shown.stage}, " if shown.stage not in ("", "mapping") else ""
            text = f"  {duration(now - shown.since)}: {frames}{stage}{shown.planned.label}{_at(shown.who)}"
            parts.append(Text(plain_line(text), no_wrap=True, overflow="ellipsis"))
        return Group(*parts)

    def _cells(self) -> Table:
        """Rows and columns of the paper's table; in a cell a sign for each seed."""
        columns = list(dict.fromkeys(shown.planned.cell.column for shown in self._runs.values()))
        by_row: dict[str, dict[str, list[_Shown]]] = {}
        for shown in self._runs.values():
            cell = shown.planned.cell
            by_row.setdefault(cell.row, {}).setdefault(cell.column, []).append(shown)
        table = Table(box=None, padding=(0, 2, 0, 0), show_header=any(columns))
        table.add_column("")
        for column in columns:
            table.add_column(Text(column))
        for row, cells in by_row.items():
            table.add_row(Text(row), *(_cell(cells.get(column, [])) for column in columns))
        return table

    def _say(self, text: str, style: str | None = None) -> None:
        width = len(str(self._to_make))
        counted = plain_line(f"[{self._told:{width}}/{self._to_make}] {text}")
        # As a Text: print's own style would also colour the live table.
        self.console.print(Text(counted, style=style or ""), soft_wrap=True)


def _cell(shown: Sequence[_Shown]) -> Text:
    text = Text()
    for each in shown:
        glyph, style = _GLYPHS[each.state]
        text.append(glyph, style=style)
        if each.state in ("running", "elsewhere") and each.frames:
            text.append(f"{100 * each.frames_done // each.frames}%", style=style)
    return text


def _at(place: str) -> str:
    return f" ({place})" if place else ""


def duration(seconds: float) -> str:
    """A time in words: "41 s", "3 min 05 s", "2 h 10 min"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
