"""What this process and its peers occupy; a process's own high-water mark does not contain its peers."""

from __future__ import annotations

import os
import threading
from pathlib import Path

STATM = Path("/proc/self/statm")
"""Absent where a system does not tell what a process occupies."""

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
