"""The limits of a run: it ends in good order before it takes the machine's memory or time away from the others."""

from __future__ import annotations

import json
import math
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench import _native
from bench.errors import BenchError
from bench.process_memory import STATM, occupied_gb
from bench.runs.status import STATUS_FILE, RunStatus

_POLL_S = 0.05
# How long a run may take to save what it has done, as in a sweep that is stopped; then its process is ended.
GRACE_S = 30.0
# How often the end of the process is put off, at most: each time its status is composed anew.
_PUT_OFF_S = 1.0
_SIGNAL = signal.SIGUSR1


StatusOf = Callable[[str], tuple[Path, RunStatus]]


@dataclass
class LimitsConfig:
    """Where a run ends itself."""

    memory_gb: float | None = None
    """How much a run may occupy, in GB of 1e9 bytes, with the processes of its plugins: the mapper keeps on disk what
    would not fit, and a run that needs more all the same ends as out of memory, before the system picks a process to
    kill; null: no limit."""
    hours: float | None = None
    """A run that takes longer, scoring included, ends as failed and saves what it has; null: no limit."""
    stall_minutes: float | None = None
    """So does one in which for so many minutes no frame, step of the last optimisation, rendered or scored view gets
    done: a plugin hangs; null: no limit."""

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value is not None and not 0 < value < math.inf:
                raise BenchError(f"limits.{name}={value} must be above 0, or null for no limit.")


class MemoryLimitError(MemoryError):
    """The run passed ``limits.memory_gb``."""


class TimeLimitError(BenchError):
    """The run passed ``limits.hours`` or ``limits.stall_minutes``."""

    exit_code = 1


class Watchdog:
    """Watches the memory of this process and its peers, its time, and that its steps follow each other.

    In the main thread passing a limit raises ``MemoryLimitError`` or ``TimeLimitError`` within about a tenth of a
    second, wherever the run is; in another thread, where no signal comes, at the next ``check``. Where that is of no
    use, in a call that never comes back to Python, the process ends with code 1 half a minute after a limit of time.
    """

    def __init__(self, limits: LimitsConfig) -> None:
        self._limits = limits
        self._seen_gb = 0.0
        self._started = self._moved = time.monotonic()
        self._put_off = -1.0
        self._stands_down = self._watching = False
        self._status_of: StatusOf | None = None

    def check(self) -> None:
        """Raise ``MemoryLimitError`` or ``TimeLimitError`` if a limit has been passed."""
        if self._stands_down:
            return
        limit_gb = self._limits.memory_gb
        if limit_gb is not None and self._seen_gb > limit_gb:
            raise MemoryLimitError(f"the run used {self._seen_gb:.2f} GB, more than limits.memory_gb={limit_gb:g}")
        end = self._end()
        if end is not None and time.monotonic() > end[0]:
            raise TimeLimitError(end[1])

    def begin(self, status_of: StatusOf) -> None:
        """A part of the run begins; ``status_of`` gives the run folder and the status that it is left with, should the
        process have to be ended for the reason given."""
        self._status_of = status_of
        self._moved = time.monotonic()
        self._put_off_the_end()

    def step(self) -> None:
        """A step is done: a frame, one of the last optimisation, a view. Raises as ``check`` does."""
        self.check()
        self._moved = time.monotonic()
        if self._moved - self._put_off > _PUT_OFF_S:
            self._put_off_the_end()

    def stand_down(self) -> None:
        """The run ends early, for whatever reason: nothing is raised any more while it saves what it has done."""
        self._stands_down = True

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch during the block; within another such block the outer one goes on."""
        limits = self._limits
        if self._watching or limits == LimitsConfig() or (self._end() is None and not STATM.is_file()):
            yield
            return
        self._watching = True
        ended = threading.Event()
        with _handled(self._on_signal) as in_main_thread:
            watcher = threading.Thread(
                target=self._watch, args=(ended, in_main_thread), name="bgs-watchdog", daemon=True
            )
            self._put_off_the_end()
            watcher.start()
            try:
                yield
            finally:
                ended.set()
                watcher.join()
                self._watching = False
                _native.end_process_never()

    def _watch(self, ended: threading.Event, in_main_thread: bool) -> None:
        while not ended.wait(_POLL_S):
            if self._limits.memory_gb is not None and STATM.is_file():
                self._seen_gb = occupied_gb()
            try:
                self.check()
            except (MemoryLimitError, TimeLimitError):
                if in_main_thread:
                    signal.pthread_kill(threading.main_thread().ident or 0, _SIGNAL)
                return

    def _end(self) -> tuple[float, str] | None:
        """The moment (``time.monotonic``) at which the run has to end, and why; None without limits of time."""
        ends = []
        if (hours := self._limits.hours) is not None:
            ends.append((self._started + 3600 * hours, f"the run took longer than limits.hours={hours:g}"))
        if (minutes := self._limits.stall_minutes) is not None:
            reason = f"nothing got done for {minutes:g} min (limits.stall_minutes={minutes:g}): a part of the run hangs"
            ends.append((self._moved + 60 * minutes, reason))
        return min(ends, default=None)

    def _put_off_the_end(self) -> None:
        """Let the process live until a while after the next limit of time."""
        end = self._end()
        if end is None:
            return
        reason = f"{end[1]}, and did not end within {GRACE_S:g} s"
        file, status = "", ""
        if self._status_of is not None:
            folder, last = self._status_of(reason)
            file, status = str(folder / STATUS_FILE), json.dumps(asdict(last))
        now = time.monotonic()
        _native.end_process_in(end[0] - now + GRACE_S, file, status, f"bgs-bench: {reason}\n")
        self._put_off = now

    def _on_signal(self, signum: int, frame: Any) -> None:
        self.check()


def stacks_of_threads() -> str:
    """Where each thread is now: one of them hangs."""
    names = {thread.ident: thread.name for thread in threading.enumerate()}
    frames = sys._current_frames().items()
    return "\n".join(f"{names.get(k, k)}:\n{''.join(traceback.format_stack(frame))}" for k, frame in frames)


@contextmanager
def _handled(handler: Any) -> Iterator[bool]:
    """Answer our signal with ``handler`` during the block; False where this is not the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    before = signal.signal(_SIGNAL, handler)
    try:
        yield True
    finally:
        signal.signal(_SIGNAL, before)
