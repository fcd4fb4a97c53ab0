"""The sweep of one machine: starts runs, so many at once, waits for those that another process makes, and ends them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bench.errors import BenchError
from bench.sweeps.child import Child
from bench.sweeps.claim import Claim, claimed_by
from bench.sweeps.job import Job, Outcome
from bench.sweeps.lookup import Found, Progress, look_up

# How often ended processes are looked for, and how long a run may take to save what it has done.
_POLL_S = 0.1
_PATIENCE_S = 30.0


class Listener(Protocol):
    """Is told what happens in a sweep."""

    def started(self, job: Job, place: str = "") -> None:
        """A run was started, at a ``place`` of a cluster or here."""

    def waits(self, job: Job, who: str) -> None:
        """A run is being made by another process, whose end is waited for."""

    def ended(self, outcome: Outcome) -> None:
        """A run ended, or needs nothing more."""

    def refresh(self) -> None:
        """Called all the time."""


@dataclass(frozen=True)
class Choice:
    """Which runs a sweep makes, by the state in which their folders are; the others stay as they are."""

    missing: bool = True
    interrupted: bool = True
    failed: bool = False
    finished: bool = False

    def wants(self, progress: Progress) -> bool:
        """Whether a run in this state is made, or, where another process makes it, waited for."""
        return {
            "missing": self.missing,
            "interrupted": self.interrupted,
            "failed": self.failed,
            "elsewhere": True,
            "out of sight": False,
            "finished": self.finished,
        }[progress]


class Sweep:
    """Makes runs in processes of their own, ``at_once`` of them; ``environment`` gives that of a slot (0 and up).

    A run that fails, crashes, is killed or can't be started ends nothing else. ``run`` raises ``KeyboardInterrupt`` on
    Ctrl-C, when the runs under way have been ended and have saved what was done. The processes inherit the files
    ``held``.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        at_once: int,
        choice: Choice,
        listener: Listener,
        environment: Callable[[int], dict[str, str]],
        held: Sequence[int] = (),
    ) -> None:
        self._pending = list(jobs)
        self._at_once = at_once
        self._choice = choice
        self._listener = listener
        self._environment = environment
        self._held = held
        self._children: dict[int, Child] = {}
        self._elsewhere: set[Path] = set()

    def run(self) -> None:
        """Make the runs; returns when each has been made, here or elsewhere, or has failed."""
        try:
            while self._pending or self._children:
                self._start_what_can_start()
                self._collect_ended()
                self._listener.refresh()
                if self._pending or self._children:
                    time.sleep(_POLL_S)
        except BaseException:
            self._end_children()
            raise

    def _start_what_can_start(self) -> None:
        free = [slot for slot in range(self._at_once) if slot not in self._children]
        for job in list(self._pending):
            if not free:
                return
            try:
                settled = self._try(job, free[0])
            except BenchError as error:
                # No lock or log file, for want of space say: this run's misfortune, not the sweep's.
                self._listener.ended(Outcome(job, Found("failed", str(error)), 0.0))
                settled = True
            if settled:
                self._pending.remove(job)
                if free[0] in self._children:
                    free.pop(0)

    def _try(self, job: Job, slot: int) -> bool:
        """Start a run, or see that it needs none; False while another process has it."""
        claim = Claim.attempt(job.folder)
        if claim is None:
            self._wait_for(job, claimed_by(job.folder))
            return False
        found = look_up(job.folder)
        if found.progress == "elsewhere":
            claim.release()
            self._wait_for(job, found.reason)
            return False
        # What another process has just made, or failed to make, is not made again.
        settled_elsewhere = found.progress in ("failed", "finished") and job.folder in self._elsewhere
        self._elsewhere.discard(job.folder)
        if settled_elsewhere or not self._choice.wants(found.progress):
            claim.release()
            self._listener.ended(Outcome(job, found, 0.0))
            return True
        try:
            self._children[slot] = Child(job, claim, self._environment(slot), self._held)
        except BaseException:
            claim.release()
            raise
        self._listener.started(job)
        return True

    def _wait_for(self, job: Job, who: str) -> None:
        if job.folder not in self._elsewhere:
            self._elsewhere.add(job.folder)
            self._listener.waits(job, who)

    def _collect_ended(self) -> None:
        for slot, child in list(self._children.items()):
            if child.has_ended():
                del self._children[slot]
                self._listener.ended(child.outcome())

    def _end_children(self) -> None:
        """Ask all to end, wait, and kill what is left; a second Ctrl-C kills at once."""
        for child in self._children.values():
            child.ask_to_end()
        try:
            until = time.monotonic() + _PATIENCE_S
            while time.monotonic() < until and not all(child.has_ended() for child in self._children.values()):
                time.sleep(_POLL_S)
        finally:
            for child in self._children.values():
                child.kill()
            self._collect_ended()
