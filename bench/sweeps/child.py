"""One run in a process of its own: started, ended politely, and what its end means."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from bench.errors import BenchError
from bench.runs.status import read_status, write_status
from bench.sweeps.claim import Claim, claim_path
from bench.sweeps.lookup import Found, look_up
from bench.sweeps.plan import PlannedRun

# Signals that someone, or a system short of memory, sends; any other that ends a process is its own fault.
_SENT = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@dataclass(frozen=True)
class Outcome:
    """How a run ended and after how many seconds; ``found`` is what its folder says now, or what went wrong before."""

    planned: PlannedRun
    found: Found
    seconds: float


def command_of(planned: PlannedRun) -> list[str]:
    """The command line that makes this run."""
    return [sys.executable, "-m", "bench.cli", "run", *planned.overrides]


def environment_of(slot: int, jobs: int, gpus: Sequence[str]) -> dict[str, str]:
    """Environment of the run in a slot (0 to jobs - 1): its share of the cores, and a GPU by turns.

    The rasterizer's threads follow ``OMP_NUM_THREADS``, so that a run's config, and its folder, are the same for any
    number of jobs.
    """
    environment = dict(os.environ)
    if jobs > 1:
        threads = str(max(1, len(os.sched_getaffinity(0)) // jobs))
        environment |= {"OMP_NUM_THREADS": threads, "OPENCV_FOR_THREADS_NUM": threads}
    if gpus:
        environment["CUDA_VISIBLE_DEVICES"] = gpus[slot % len(gpus)]
    return environment


class Child:
    """A started run; ``claim`` is held until its end has been read.

    Raises ``BenchError`` where the process can't be started; the claim is then still the caller's.
    """

    def __init__(self, planned: PlannedRun, claim: Claim, environment: dict[str, str]) -> None:
        self.planned = planned
        self.started = time.monotonic()
        self._claim = claim
        self._log = claim_path(planned.folder, "log")
        try:
            with open(self._log, "wb") as log:
                # A group of its own: a Ctrl-C in the terminal reaches the sweep alone, which then ends its runs.
                self._process = subprocess.Popen(
                    command_of(planned),
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env=environment,
                    pass_fds=[claim.fd],
                    process_group=0,
                )
        except OSError as error:
            raise BenchError(
                f"Can't start {planned.label}: {error}. Check the free memory and the place of {self._log}."
            ) from error
        try:
            claim.note(self._process.pid)
        except BenchError:
            self.kill()
            raise

    @property
    def seconds(self) -> float:
        """Since the start."""
        return time.monotonic() - self.started

    def has_ended(self) -> bool:
        """Whether the process has ended."""
        return self._process.poll() is not None

    def ask_to_end(self) -> None:
        """SIGTERM: the run saves what it has done."""
        if not self.has_ended():
            self._process.terminate()

    def kill(self) -> None:
        """End it at once, with what it started."""
        if not self.has_ended():
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def outcome(self) -> Outcome:
        """Read how it ended, complete the run's status where it could not, and let go of the claim. Call it once."""
        code = self._process.wait()
        try:
            return Outcome(self.planned, self._found(code), self.seconds)
        finally:
            self._claim.release()

    def _found(self, code: int) -> Found:
        said = _last_words(self._log)
        if code < 0:
            hint = ", by hand or for want of memory" if -code == signal.SIGKILL else ""
            said = f"ended by signal {-code} ({signal.strsignal(-code)}){hint}"
        self._complete_status(said, was_sent=-code in _SENT)
        found = look_up(self.planned.folder)
        if found.progress == "finished":
            # A run that was already there, or that broke when all was saved.
            return found
        if found.progress == "missing" or (found.progress == "interrupted" and code > 0 and code != 130):
            # It never got as far as a status (wrong settings, missing weights), or its scoring failed.
            return Found("interrupted" if -code in _SENT else "failed", said)
        return found

    def _complete_status(self, reason: str, was_sent: bool) -> None:
        """A process that was killed, or crashed, left "running" behind: say why, and whether it failed by itself."""
        try:
            status = read_status(self.planned.folder)
        except BenchError:
            return  # damaged; looking the folder up says so
        if status is not None and status.state == "running" and status.pid == self._process.pid:
            state = "running" if was_sent else "failed"
            write_status(self.planned.folder, replace(status, state=state, reason=reason))


def _last_words(log: Path) -> str:
    """The error that the command printed, else its last line."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    errors = [line.removeprefix("bgs-bench: ") for line in lines if line.startswith("bgs-bench: ")]
    return (errors or lines or [f"it said nothing; its output is in {log}"])[-1]
