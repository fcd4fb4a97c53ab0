"""The sweep: starts the runs of a plan, so many at once, waits for those that another process makes, and ends them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.sweeps.child import Child, Outcome, environment_of
from bench.sweeps.claim import Claim, claimed_by
from bench.sweeps.lookup import Progress, look_up
from bench.sweeps.plan import PlannedRun
from bench.sweeps.view import SweepView

# How often ended processes are looked for, and how long a run may take to save what it has done.
_POLL_S = 0.1
_PATIENCE_S = 30.0


@dataclass(frozen=True)
class Choice:
    """Which runs a sweep makes, by the state in which their folders are; the others stay as they are."""

    missing: bool = True
    interrupted: bool = True
    failed: bool = False

    def wants(self, progress: Progress) -> bool:
        """Whether a run in this state is made, or, where another process makes it, waited for."""
        return {
            "missing": self.missing,
            "interrupted": self.interrupted,
            "failed": self.failed,
            "elsewhere": True,
            "out of sight": False,
            "finished": False,
        }[progress]


class Sweep:
    """Makes runs in processes of their own, ``jobs`` at once; ``gpus`` are dealt out to the jobs in turn.

    A run that fails, crashes or is killed ends nothing else. ``run`` raises ``KeyboardInterrupt`` on Ctrl-C, when the
    runs under way have been ended and have saved what was done.
    """

    def __init__(
        self, runs: Sequence[PlannedRun], jobs: int, choice: Choice, view: SweepView, gpus: Sequence[str] = ()
    ) -> None:
        self._pending = list(runs)
        self._jobs = jobs
        self._choice = choice
        self._view = view
        self._gpus = gpus
        self._children: dict[int, Child] = {}
        self._elsewhere: set[Path] = set()

    def run(self) -> None:
        """Make the runs; returns when each has been made, here or elsewhere, or has failed."""
        try:
            while self._pending or self._children:
                self._start_what_can_start()
                self._collect_ended()
                self._view.refresh()
                time.sleep(_POLL_S)
        except BaseException:
            self._end_children()
            raise

    def _start_what_can_start(self) -> None:
        free = [slot for slot in range(self._jobs) if slot not in self._children]
        for planned in list(self._pending):
            if not free:
                return
            if self._try(planned, free[0]):
                self._pending.remove(planned)
                if free[0] in self._children:
                    free.pop(0)

    def _try(self, planned: PlannedRun, slot: int) -> bool:
        """Start a run, or see that it needs none; False while another process has it."""
        claim = Claim.attempt(planned.folder)
        if claim is None:
            self._wait_for(planned, claimed_by(planned.folder))
            return False
        found = look_up(planned.folder)
        if found.progress == "elsewhere":
            claim.release()
            self._wait_for(planned, found.reason)
            return False
        failed_elsewhere = found.progress == "failed" and planned.folder in self._elsewhere
        self._elsewhere.discard(planned.folder)
        if failed_elsewhere or not self._choice.wants(found.progress):
            claim.release()
            self._view.ended(Outcome(planned, found, 0.0))
            return True
        try:
            self._children[slot] = Child(planned, claim, environment_of(slot, self._jobs, self._gpus))
        except BaseException:
            claim.release()
            raise
        self._view.started(planned)
        return True

    def _wait_for(self, planned: PlannedRun, who: str) -> None:
        if planned.folder not in self._elsewhere:
            self._elsewhere.add(planned.folder)
            self._view.waits(planned, who)

    def _collect_ended(self) -> None:
        for slot, child in list(self._children.items()):
            if child.has_ended():
                del self._children[slot]
                self._view.ended(child.outcome())

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
