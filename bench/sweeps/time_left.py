"""How long a sweep still takes, by the frames of its runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class RunProgress:
    """A run's part in the estimate. Runs of one ``kind`` (a row of a table) take the same time per frame.

    ``state``: "waiting", "running", "finished" (``seconds`` is what it took), or "gone" (failed, stopped: no part of
    it). A running one has been at it for ``seconds``; ``frames`` is 0 while nobody knows how many it has.
    """

    kind: str
    state: Literal["waiting", "running", "finished", "gone"]
    frames: int = 0
    frames_done: int = 0
    seconds: float = 0.0


def seconds_left(runs: Sequence[RunProgress], at_once: int) -> float | None:
    """By the seconds per frame of the finished runs of each kind, else of the running, else of all; None before any.

    No less than the longest run alone, and than all of them spread over ``at_once`` places.
    """
    paces = _paces(runs)
    if not paces:
        return None
    overall = sum(paces.values()) / len(paces)
    known = [run.frames for run in runs if run.frames]
    usual = sum(known) / len(known) if known else 1.0
    left = []
    for run in runs:
        pace, frames = paces.get(run.kind, overall), run.frames or usual
        if run.state == "waiting":
            left.append(frames * pace)
        elif run.state == "running":
            left.append((frames - run.frames_done) * pace if run.frames_done else max(frames * pace - run.seconds, 0.0))
    return max([sum(left) / max(at_once, 1), *left], default=0.0)


def _paces(runs: Sequence[RunProgress]) -> dict[str, float]:
    """Seconds per frame of each kind of which something is known."""
    finished: dict[str, list[float]] = {}
    running: dict[str, list[float]] = {}
    for run in runs:
        if run.state == "finished" and run.seconds > 0:
            finished.setdefault(run.kind, []).append(run.seconds / max(run.frames, 1))
        elif run.state == "running" and run.frames_done > 0:
            running.setdefault(run.kind, []).append(run.seconds / run.frames_done)
    return {kind: sum(paces) / len(paces) for kind, paces in (running | finished).items()}
