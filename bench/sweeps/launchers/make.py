"""Make the runs of a plan by a launcher, in view of the user: what ``run -m`` and ``reproduce`` have in common."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bench.io.file_lock import has_locks
from bench.sweeps.child import environment_of
from bench.sweeps.launchers.choice import BASIC, LauncherChoice
from bench.sweeps.launchers.gpus import gpus_of_this_machine
from bench.sweeps.launchers.launched import LaunchedSweep
from bench.sweeps.lookup import look_up
from bench.sweeps.plan import Plan
from bench.sweeps.sweep import Choice, Sweep
from bench.sweeps.view import SweepView
from bench.terminal import say


def make_runs(plan: Plan, launcher: LauncherChoice, choice: Choice, view: SweepView) -> None:
    """Make those runs of the plan that ``choice`` wants, and show it; one that fails stops no other.

    Raises ``KeyboardInterrupt`` on Ctrl-C or a polite kill, when the runs under way have saved what was done.
    """
    jobs = []
    for planned in plan.runs:
        found = look_up(planned.folder)
        if choice.wants(found.progress):
            jobs.append(planned.job)
        else:
            view.leave(planned, found)
    if jobs and not _has_locks(plan.root):
        text = f"{plan.root} is on a file system without locks: one run at a time; don't start the same runs twice"
        say(text, view.console)
        launcher = LauncherChoice(at_once=1)
    gpus = gpus_of_this_machine()
    at_once = launcher.at_once
    with _terminate_as_interrupt(), view:
        if launcher.name == BASIC:
            Sweep(jobs, at_once, choice, view, lambda slot: environment_of(slot, at_once, gpus)).run()
        elif jobs:
            LaunchedSweep(jobs, launcher, choice, view, plan.root, gpus).run()


def _has_locks(root: Path) -> bool:
    try:
        root.mkdir(parents=True, exist_ok=True)
        return has_locks(root)
    except OSError:  # what can't be written there is told of each run
        return True


@contextmanager
def _terminate_as_interrupt() -> Iterator[None]:
    """A polite kill (SIGTERM) ends the sweep like Ctrl-C."""

    def interrupt(signum: int, frame: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
