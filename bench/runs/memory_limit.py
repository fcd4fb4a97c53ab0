"""``limits.memory_gb``: a run ends in good order before it takes the machine's memory away from the others."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bench.process_memory import peers_now_gb

_POLL_S = 0.05
_STATM = Path("/proc/self/statm")
_SIGNAL = signal.SIGUSR1


class MemoryLimitError(MemoryError):
    """The run passed ``limits.memory_gb``."""


class MemoryLimit:
    """Watches the resident memory of this process and its peers; ``None`` GB (of 1e9 bytes) watches nothing.

    In the main thread passing the limit raises ``MemoryLimitError`` within about a tenth of a second, wherever the run
    is; in another thread, where no signal comes, at the next ``check``.
    """

    def __init__(self, limit_gb: float | None) -> None:
        self._limit_gb = limit_gb
        self._seen_gb = 0.0

    def check(self) -> None:
        """Raise ``MemoryLimitError`` if the limit has been passed."""
        if self._limit_gb is not None and self._seen_gb > self._limit_gb:
            raise MemoryLimitError(
                f"the run used {self._seen_gb:.2f} GB, more than limits.memory_gb={self._limit_gb:g}"
            )

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch during the block."""
        if self._limit_gb is None or not _STATM.is_file():
            yield
            return
        ended = threading.Event()
        with _handled(self._on_signal) as in_main_thread:
            watcher = threading.Thread(target=self._watch, args=(ended, in_main_thread), name="bgs-memory", daemon=True)
            watcher.start()
            try:
                yield
            finally:
                ended.set()
                watcher.join()

    def _watch(self, ended: threading.Event, in_main_thread: bool) -> None:
        assert self._limit_gb is not None
        while not ended.wait(_POLL_S):
            self._seen_gb = _resident_gb() + peers_now_gb()
            if self._seen_gb > self._limit_gb:
                if in_main_thread:
                    signal.pthread_kill(threading.main_thread().ident or 0, _SIGNAL)
                return

    def _on_signal(self, signum: int, frame: Any) -> None:
        self.check()


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


def _resident_gb() -> float:
    return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9
