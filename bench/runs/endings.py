"""How a run ends early: by which signal, and what its status says."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bench.errors import BenchError

# The name of torch's error on the GPU (torch takes a while to load), and how its and OpenCV's on the CPU speak of it.
_TORCH = "OutOfMemoryError"
_MEMORY_WORDS = ("can't allocate memory", "Insufficient memory")


def how_it_ended(error: BaseException) -> tuple[str, str]:
    """State and reason for ``status.json``."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", "stopped by the user"
    text = str(error) or type(error).__name__
    if (
        isinstance(error, MemoryError)
        or type(error).__name__ == _TORCH
        or any(words in text for words in _MEMORY_WORDS)
    ):
        return "out_of_memory", text.split("\n", 1)[0]
    return "failed", text if isinstance(error, BenchError) else f"{type(error).__name__}: {text}"


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """A polite kill (SIGTERM) ends a run like Ctrl-C: what was done is saved."""

    def interrupt(signum: int, frame: Any) -> None:
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:  # not in the main thread, where signals can't be handled
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
