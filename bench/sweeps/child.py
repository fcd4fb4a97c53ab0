"""One run in a process of its own: started, ended politely, and what its end means."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bench.errors import BenchError
from bench.runs.status import read_status, write_status
from bench.sweeps.claim import Claim, claim_path
from bench.sweeps.job import Job, Outcome
from bench.sweeps.lookup import Found, look_up
from bench.sweeps.oom_kills import oom_kills

# Signals that someone, a system short of memory, or a cluster at a job's time limit sends; any other is the fault
# of the process that it ends.
_SENT = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
_OUT_OF_MEMORY = "the system ended it for want of memory"


def environment_of(slot: int, jobs: int, gpus: Sequence[str]) -> dict[str, str]:
    """Environment of the run in a slot (0 to jobs - 1): its share of the cores, and a GPU by turns.

    The core's threads follow ``OMP_NUM_THREADS`` where a run's ``threads`` is 0. With more jobs than GPUs some share
    one.
    """
    environment = dict(os.environ)
    if jobs > 1:
        threads = str(max(1, len(os.sched_getaffinity(0)) // jobs))
        environment |= {"OMP_NUM_THREADS": threads, "OPENCV_FOR_THREADS_NUM": threads}
    if gpus:
        environment["CUDA_VISIBLE_DEVICES"] = gpus[slot % len(gpus)]
    return environment


class Child:
    """A started run; ``claim`` is held until its end has been read. It inherits the files ``held`` too (locks).

    Raises ``BenchError`` where the process can't be started; the claim is then still the caller's.
    """

    def __init__(self, job: Job, claim: Claim, environment: dict[str, str], held: Sequence[int] = ()) -> None:
        self.job = job
        self.started = time.monotonic()
        self._claim = claim
        self._log = claim_path(job.folder, "log")
        self._oom_kills = oom_kills()
        try:
            with open(self._log, "wb") as log:
                # A group of its own: a Ctrl-C in the terminal reaches the sweep alone, which then ends its runs.
                # -P: no numpy.py that happens to lie in the current folder is taken for the module.
                self._process = subprocess.Popen(
                    [sys.executable, "-P", *job.arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env=environment,
                    cwd=job.cwd,
                    pass_fds=[claim.fd, *held],
                    process_group=0,
                )
        except OSError as error:
            raise BenchError(
                f"Can't start {job.label}: {error}. Check the free memory and the place of {self._log}."
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
            return Outcome(self.job, self._found(code), self.seconds)
        finally:
            self._claim.release()

    def _found(self, code: int) -> Found:
        said, state = _last_words(self._log), "failed"
        if code == 0:
            said = "its process ended with exit code 0 before the run was done: did a plugin end it?"
        if code < 0:
            said = f"ended by signal {-code} ({signal.strsignal(-code)})"
        if -code == signal.SIGKILL and self._memory_ran_out():
            said, state = _OUT_OF_MEMORY, "out_of_memory"
        elif -code in _SENT:
            said += ", by hand or for want of memory" if -code == signal.SIGKILL and self._oom_kills is None else ""
            state = "running"
        try:
            self._complete_status(said, state)
        except BenchError as error:
            said += f" (that could not be noted in its folder: {error})"
        found = look_up(self.job.folder)
        if found.progress == "finished":
            # A run that was already there, or that broke when all was saved.
            return found
        words = f"out of memory: {said}" if state == "out_of_memory" else said
        unsaid = found.progress == "interrupted" and code < 0
        if found.progress == "missing" or unsaid or (found.progress == "interrupted" and code != 130):
            # It never got as far as a status (wrong settings, missing weights), could not write it, or its scoring
            # failed.
            return Found("interrupted" if state == "running" else "failed", words)
        return found

    def _memory_ran_out(self) -> bool:
        now = oom_kills()
        return self._oom_kills is not None and now is not None and now > self._oom_kills

    def _complete_status(self, reason: str, state: str) -> None:
        """A process that was killed, or crashed, left "running" behind: say why, and whether it failed by itself.

        Raises ``BenchError`` where that can't be written.
        """
        try:
            status = read_status(self.job.folder)
        except BenchError:
            return  # damaged; looking the folder up says so
        if status is not None and status.state == "running" and status.pid == self._process.pid:
            write_status(self.job.folder, replace(status, state=state, reason=reason))


def _last_words(log: Path) -> str:
    """The error that the command printed, else its last line."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    errors = [line.removeprefix("bgs-bench: ") for line in lines if line.startswith("bgs-bench: ")]
    return (errors or lines or [f"it said nothing; its output is in {log}"])[-1]
