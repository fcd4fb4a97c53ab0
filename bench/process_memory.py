"""What this process and its peers occupy; a process's own high-water mark does not contain its peers."""

from __future__ import annotations

import ctypes
import math
import os
import threading
import time
from pathlib import Path

STATM = Path("/proc/self/statm")
"""Absent where a system does not tell what a process occupies."""

_LOOK_EACH_S = 0.5

_lock = threading.Lock()
_peaks_kib: dict[int, int] = {}


def note_peak(pid: int) -> None:
    """Remember the high-water mark of a running peer; called after each of its answers. No more than a file is read."""
    peak = _kib(pid, "VmHWM")
    if peak is not None:
        with _lock:
            _peaks_kib[pid] = peak


def peers_now_gb() -> float:
    """What the peers that have answered and still run occupy now, in GB of 1e9 bytes."""
    with _lock:
        pids = list(_peaks_kib)
    return sum(_kib(pid, "VmRSS") or 0 for pid in pids) * 1024 / 1e9


def occupied_gb() -> float:
    """Resident memory of this process and its running peers, in GB of 1e9 bytes; raises ``OSError`` without /proc."""
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9 + peers_now_gb()


def release_free_memory() -> None:
    """Give pages of the heap that nothing uses back to the system, where the C library can (glibc): milliseconds."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if STATM.is_file() else None
    if trim is not None:
        trim(0)


def forget_peaks() -> None:
    """Begin a new measurement; peers that still run come back with their next answer."""
    with _lock:
        _peaks_kib.clear()


def peers_peak_gb() -> float:
    """Sum of the peers' peaks, ended ones included, in GB of 1e9 bytes; 0 without peers."""
    with _lock:
        return sum(_peaks_kib.values()) * 1024 / 1e9


def _kib(pid: int, what: str) -> int | None:
    """A line of ``/proc/<pid>/status``; None where it has just ended, or this system has no /proc."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith(f"{what}:")), None)


class MemoryBudget:
    """How much of ``limits.memory_gb`` a run has left. A part asks before it keeps in memory what it could read again
    from disk; what it computes must not depend on the answer.

    ``limit_gb`` is None where there is no limit. Asking costs nothing: the system is asked twice a second at most.
    """

    def __init__(self, limit_gb: float | None) -> None:
        self.limit_gb = limit_gb
        self._looked = -math.inf
        self._occupied_gb = 0.0

    def occupied_gb(self) -> float:
        """What the run occupies, peers included, as of half a second ago or less; 0 where the system does not tell."""
        now = time.monotonic()
        if now - self._looked >= _LOOK_EACH_S:
            self._looked, self._occupied_gb = now, occupied_gb() if STATM.is_file() else 0.0
        return self._occupied_gb

    def left_gb(self) -> float:
        """What may still be taken: infinite without a limit, below 0 where it is passed already."""
        return math.inf if self.limit_gb is None else self.limit_gb - self.occupied_gb()
