"""A sweep whose runs a Hydra launcher makes: hands them over, watches from here, and outlasts workers that die."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.errors import BenchError
from bench.sweeps.claim import is_claimed
from bench.sweeps.job import Job
from bench.sweeps.launchers.choice import LauncherChoice
from bench.sweeps.launchers.exchange import Exchange, Note
from bench.sweeps.launchers.launch import ORDER_FILE, Order
from bench.sweeps.launchers.slots import Slots
from bench.sweeps.launchers.worker import RunTask
from bench.sweeps.lookup import Found, look_up
from bench.sweeps.sweep import Choice, Listener

_POLL_S = 0.2
# A run whose worker died may go on alone. When nobody has claimed it for so long, it doesn't.
_QUIET_S = 3.0
# What runs may take to save what they have done, and a launcher to end when all its runs have.
_PATIENCE_S = 40.0


@dataclass
class _Watched:
    """A run that was handed over, and the last that its worker told."""

    number: int
    job: Job
    note: Note | None = None
    unclaimed_since: float | None = None
    left: bool = False
    """Its worker died before there was anything of the run."""

    @property
    def has_ended(self) -> bool:
        return self.note is not None and self.note.state == "ended"


class LaunchedSweep:
    """Makes runs through a launcher; ``gpus`` are dealt out by the workers where the launcher works on this machine.

    A worker that dies ends its own run at most: the launcher is started again for those that had not begun. ``run``
    raises ``KeyboardInterrupt`` on Ctrl-C, when the runs under way have ended and have saved what was done.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        launcher: LauncherChoice,
        choice: Choice,
        listener: Listener,
        root: Path,
        gpus: Sequence[str] = (),
    ) -> None:
        self._jobs = list(jobs)
        self._launcher = launcher
        self._choice = choice
        self._listener = listener
        self._root = root.absolute()
        self._gpus = tuple(gpus)

    def run(self) -> None:
        """Make the runs; returns when each has been made, here or elsewhere, or has failed."""
        jobs = self._jobs
        while jobs:
            jobs = self._make(jobs)

    def _make(self, jobs: list[Job]) -> list[Job]:
        """Start the launcher once; returns the runs that never began, because it failed."""
        exchange = Exchange.create(self._root)
        watched = [_Watched(number, job) for number, job in enumerate(jobs)]
        launch = _Launch(self._order(jobs, exchange))
        try:
            while not launch.has_ended():
                self._look(exchange, watched)
                time.sleep(_POLL_S)
            self._look(exchange, watched)
            if not launch.succeeded():
                exchange.begin_no_more()
            self._outlast(exchange, watched, launch.last_words())
            left = [each for each in watched if not each.has_ended]
        except BaseException:
            self._stop(exchange, watched, launch)
            raise
        if launch.succeeded():
            exchange.remove()
        elif len(left) < len(jobs):
            return [each.job for each in left]
        for each in left:
            found = look_up(each.job.folder)
            reason = f"launcher={self._launcher.name}: {launch.last_words()}"
            self._ended(each, found if found.progress in ("finished", "failed") else Found("failed", reason))
        return []

    def _order(self, jobs: list[Job], exchange: Exchange) -> Order:
        chosen = self._launcher
        slots = Slots(exchange.folder, chosen.at_once, self._gpus) if chosen.at_once else None
        # A cluster's workers have the environment of those who started the cluster.
        environment = {name: value for name, value in os.environ.items() if name.startswith("BGS_")}
        task = RunTask(tuple(jobs), self._choice, exchange, slots, environment)
        return Order(task, chosen.name, chosen.settings, chosen.at_once)

    def _look(self, exchange: Exchange, watched: list[_Watched]) -> None:
        """Pass on what workers have told since the last time."""
        for each in watched:
            note = None if each.has_ended or each.left else exchange.read(each.number)
            if note is None or note == each.note:
                continue
            each.note = note
            if note.state == "running":
                self._listener.started(each.job, note.place)
            elif note.state == "waiting":
                self._listener.waits(each.job, note.who)
            elif note.state == "ended":
                self._listener.ended(note.outcome(each.job))
        self._listener.refresh()

    def _outlast(self, exchange: Exchange, watched: list[_Watched], reason: str) -> None:
        """Wait for the runs that had begun when the launcher ended, whose workers live on or whose workers died."""
        begun = [each for each in watched if each.note is not None]
        while unended := [each for each in begun if not (each.has_ended or each.left)]:
            self._look(exchange, watched)
            for each in unended:
                self._see_whether_it_died(each, reason)
            time.sleep(_POLL_S)

    def _see_whether_it_died(self, each: _Watched, reason: str) -> None:
        found = look_up(each.job.folder)
        if each.has_ended or is_claimed(each.job.folder) or found.progress == "elsewhere":
            each.unclaimed_since = None
            return
        now = time.monotonic()
        if each.unclaimed_since is None:
            each.unclaimed_since = now
        if now - each.unclaimed_since > _QUIET_S:
            # A launcher that loses one worker may end its others too, also one that is about to start its run.
            each.left = found.progress == "missing"
            if found.progress == "interrupted":
                found = Found("interrupted", f"its worker died ({reason})")
            if not each.left:
                self._ended(each, found)

    def _ended(self, each: _Watched, found: Found) -> None:
        each.note = Note("ended", found=found)
        self._listener.ended(each.note.outcome(each.job))

    def _stop(self, exchange: Exchange, watched: list[_Watched], launch: _Launch) -> None:
        """Ask the workers to end their runs, wait, and end the launcher; a second Ctrl-C ends it at once."""
        exchange.stop()
        try:
            until = time.monotonic() + _PATIENCE_S
            while time.monotonic() < until and not launch.has_ended():
                self._look(exchange, watched)
                if all(each.has_ended for each in watched if each.note is not None):
                    break
                time.sleep(_POLL_S)
        finally:
            launch.end()


class _Launch:
    """The launcher's process; raises ``BenchError`` where it can't be started."""

    def __init__(self, order: Order) -> None:
        folder = order.task.exchange.folder
        self._log = folder / "launcher.log"
        try:
            (folder / ORDER_FILE).write_bytes(pickle.dumps(order))
            with open(self._log, "wb") as log:
                # A group of its own, because of Ctrl-C, as for runs. It ends when its standard input does.
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", "bench.sweeps.launchers.launch", str(folder)],
                    # For the workers that it starts in its turn: as -P, no module from the current folder.
                    env=os.environ | {"PYTHONSAFEPATH": "1"},
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    process_group=0,
                )
        except OSError as error:
            raise BenchError(f"Can't start launcher={order.launcher}: {error}. Check the place {folder}.") from error

    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def succeeded(self) -> bool:
        return self._process.wait() == 0

    def end(self) -> None:
        """At once, with the workers that it started itself."""
        if not self.has_ended():
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def last_words(self) -> str:
        """The launcher's error, else the last line of its log."""
        if not self._log.exists():
            return f"it ended with code {self._process.wait()}"
        lines = [line.strip() for line in self._log.read_text(errors="replace").splitlines() if line.strip()]
        errors = [line.removeprefix("bgs-bench: ") for line in lines if line.startswith("bgs-bench: ")]
        return (errors or lines or [f"it ended with code {self._process.wait()}; its output is in {self._log}"])[-1]
