"""What a launcher's worker does with one run: claims it, makes it in a process of its own, and tells how it ended."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from bench.errors import BenchError
from bench.sweeps.child import environment_of
from bench.sweeps.job import Job, Outcome
from bench.sweeps.launchers.exchange import Exchange, Note
from bench.sweeps.launchers.slots import Slots
from bench.sweeps.lookup import Found
from bench.sweeps.sweep import Choice, Sweep


@dataclass(frozen=True)
class RunTask:
    """The task function that a Hydra launcher calls: with a config whose ``job`` is the number of a run.

    It survives whatever the run does, as that is another process. ``slots`` share out the machine where the launcher
    does not do that itself; ``environment`` is what runs need of the environment in which the sweep was started.
    """

    jobs: tuple[Job, ...]
    choice: Choice
    exchange: Exchange
    slots: Slots | None
    environment: Mapping[str, str]

    def __call__(self, config: Any) -> Outcome:
        number = int(config.job)
        job, told = self.jobs[number], _Told(self.exchange, number)
        not_begun = Outcome(job, Found("interrupted", "the sweep was stopped before it began"), 0.0)
        try:
            with nullcontext((0, -1)) if self.slots is None else self.slots.one(told.refresh) as (slot, file):
                if not self.exchange.may_begin():
                    return not_begun
                told.begun()
                held = [] if file < 0 else [file]
                Sweep([job], 1, self.choice, told, lambda _: self._environment(slot), held).run()
        except KeyboardInterrupt:
            return told.outcome or not_begun
        assert told.outcome is not None
        return told.outcome

    def _environment(self, slot: int) -> dict[str, str]:
        if self.slots is None:
            return os.environ | dict(self.environment)
        return environment_of(slot, self.slots.count, self.slots.gpus) | dict(self.environment)


class _Told:
    """Hands what happens to the sweep, through the exchange; ends the run when the sweep wants to stop."""

    def __init__(self, exchange: Exchange, number: int) -> None:
        self.outcome: Outcome | None = None
        self._exchange = exchange
        self._number = number
        self._place = _place()

    def begun(self) -> None:
        self._tell(Note("begun", self._place))

    def started(self, job: Job, place: str = "") -> None:
        self._tell(Note("running", self._place))

    def waits(self, job: Job, who: str) -> None:
        self._tell(Note("waiting", self._place, who))

    def ended(self, outcome: Outcome) -> None:
        self.outcome = Outcome(outcome.job, outcome.found, outcome.seconds, self._place)
        self._tell(Note("ended", self._place, "", outcome.found, outcome.seconds))

    def refresh(self) -> None:
        if self._exchange.stopped():
            raise KeyboardInterrupt

    def _tell(self, note: Note) -> None:
        try:
            self._exchange.write(self._number, note)
        except BenchError as error:
            # A full disk, say: the outcome goes back through the launcher all the same.
            print(f"worker of run {self._number}: {error}", file=sys.stderr)


def _place() -> str:
    """The machine, and on a Ray cluster the node, of which a machine may have several."""
    host = socket.gethostname()
    ray = sys.modules.get("ray")
    if ray is None or not ray.is_initialized():
        return host
    return f"{host}, Ray node {ray.get_runtime_context().get_node_id()[:8]}"
