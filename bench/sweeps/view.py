"""What a sweep tells while it runs: a line for each event, and in a terminal a live summary below them."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from bench.sweeps.child import Outcome
from bench.sweeps.plan import PlannedRun

_REFRESH_S = 0.5


@dataclass
class SweepView:
    """Counts and prints. ``total`` runs are to be made (or waited for), ``jobs`` at once.

    A context manager: the live summary is there within it, and only where the console is a terminal.
    """

    console: Console
    title: str
    total: int
    jobs: int
    _running: dict[str, float] = field(default_factory=dict)
    _waiting: dict[str, str] = field(default_factory=dict)
    _outcomes: list[Outcome] = field(default_factory=list)
    _live: Live | None = None
    _refreshed: float = 0.0

    def __enter__(self) -> SweepView:
        if self.console.is_terminal:
            self._live = Live(console=self.console, get_renderable=self._summary, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.stop()

    def started(self, planned: PlannedRun) -> None:
        """A run was started here."""
        self._waiting.pop(planned.label, None)
        self._running[planned.label] = time.monotonic()
        if self._live is None:
            self._say(f"started: {planned.label}")

    def waits(self, planned: PlannedRun, who: str) -> None:
        """A run is being made by another process; its end is waited for."""
        self._waiting[planned.label] = who
        self._say(f"running elsewhere ({who}): {planned.label}", "yellow")

    def ended(self, outcome: Outcome) -> None:
        """A run ended, here or elsewhere, or needs nothing more."""
        label = outcome.planned.label
        here = self._running.pop(label, None) is not None
        self._waiting.pop(label, None)
        self._outcomes.append(outcome)
        if outcome.found.progress == "finished":
            how = f"done in {duration(outcome.seconds)}" if here else "done elsewhere"
            self._say(f"{how}: {label}")
            return
        reason = f" ({outcome.found.reason})" if outcome.found.reason else ""
        self._say(f"{outcome.found.progress}: {label}{reason}", "red")

    def refresh(self) -> None:
        """Redraw the summary, at most every half second."""
        now = time.monotonic()
        if self._live is not None and now - self._refreshed > _REFRESH_S:
            self._refreshed = now
            self._live.refresh()

    def summary_line(self) -> str:
        """How far the sweep is, in a line."""
        done = sum(outcome.found.progress == "finished" for outcome in self._outcomes)
        parts = [f"{done} of {self.total} done", f"{len(self._running)} running"]
        if failed := len(self._outcomes) - done:
            parts.append(f"{failed} failed or stopped")
        if self._waiting:
            parts.append(f"{len(self._waiting)} running elsewhere")
        left = self.seconds_left()
        return f"{self.title}: {', '.join(parts)}" + ("" if left is None else f"; about {duration(left)} left")

    def seconds_left(self) -> float | None:
        """By the mean time of the runs that were finished here; None before the first."""
        times = [each.seconds for each in self._outcomes if each.found.progress == "finished" and each.seconds > 0]
        if not times:
            return None
        mean = sum(times) / len(times)
        now = time.monotonic()
        under_way = sum(max(mean - (now - started), 0.0) for started in self._running.values())
        waiting = max(self.total - len(self._outcomes) - len(self._running) - len(self._waiting), 0)
        return (under_way + waiting * mean) / self.jobs

    def _summary(self) -> Group:
        now = time.monotonic()
        lines = [Text(self.summary_line(), style="bold")]
        lines += [Text(f"  running {duration(now - start)}: {label}") for label, start in self._running.items()]
        lines += [Text(f"  waiting for {who}: {label}") for label, who in self._waiting.items()]
        return Group(*lines)

    def _say(self, text: str, style: str | None = None) -> None:
        width = len(str(self.total))
        counted = f"[{len(self._outcomes):{width}}/{self.total}] {text}"
        # As a Text: print's own style would also colour the live summary.
        self.console.print(Text(counted, style=style or ""), soft_wrap=True)


def duration(seconds: float) -> str:
    """A time in words: "41 s", "3 min 05 s", "2 h 10 min"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
