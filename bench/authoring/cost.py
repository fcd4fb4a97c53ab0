"""What a call costs: milliseconds, peak memory, and the memory that it leaves behind."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch

from bench.authoring.probes import FULL_SIZE
from bench.authoring.verdict import ContractBrokenError, Note
from bench.runs.memory import PeakMemory

_SECONDS = 6.0
_MAX_CALLS = 6


@dataclass(frozen=True)
class Cost:
    """Of repeated calls: median milliseconds, MB that each call leaves behind (None: not measurable here), peak MB
    above what was resident before."""

    calls: int
    ms: float
    left_mb: list[float] | None
    peak_mb: float


def cost_of(call: Callable[[], object]) -> Cost:
    """Time and memory of a call after one to warm up; a few seconds, or two calls where they take longer."""
    gc.collect()
    before, peak = resident_mb(), PeakMemory()
    call()
    gc.collect()
    times: list[float] = []
    in_use = [allocated_mb()]
    while len(times) < 2 or (len(times) < _MAX_CALLS and sum(times) < _SECONDS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
        gc.collect()
        in_use.append(allocated_mb())
    left = [b - a for a, b in pairwise(in_use) if a is not None and b is not None] or None
    above = max(peak.host_gb() * 1e3 - (before or 0.0), 0.0)
    return Cost(len(times), float(np.median(times)) * 1e3, left, above)


class _Mallinfo2(ctypes.Structure):
    """What glibc (2.33 and newer) tells of its heap; bytes."""

    _fields_: ClassVar = [
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "free",
            "fast",
            "mapped",
            "hblkhd",
            "unused",
            "fast_bytes",
            "uordblks",
            "free_bytes",
            "top",
        )
    ]


def allocated_mb() -> float | None:
    """MB that are allocated and not freed, by numpy, torch or OpenCV; resident memory where the C library can't tell.

    Resident memory alone would miss a leak into what was freed before.
    """
    if not sys.platform.startswith("linux") or not hasattr(ctypes.CDLL(None), "mallinfo2"):
        return resident_mb()
    ask = ctypes.CDLL(None).mallinfo2
    ask.restype = _Mallinfo2
    told = ask()
    return float(told.uordblks + told.hblkhd) / 1e6


def resident_mb() -> float | None:
    """Resident memory of this process in MB; None where the system has no /proc."""
    statm = Path("/proc/self/statm")
    if not statm.is_file():
        return None
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def describe_cost(cost: Cost, result_mb: float, method: str) -> str | Note:
    """Speed and memory in words; ``ContractBrokenError`` where each call leaves about a result behind."""
    speed = f"{cost.ms:.1f} ms for {FULL_SIZE[1]}x{FULL_SIZE[0]} with {torch.get_num_threads()} threads"
    if cost.left_mb is None:
        return Note(f"{speed}; memory can't be measured on this system")
    # The first call or two may still fill caches; a leak goes on.
    late = cost.left_mb[1:]
    if min(late) > 0.5 * result_mb:
        raise ContractBrokenError(
            f"each of {cost.calls} calls left {np.mean(late):.1f} MB behind ({speed})",
            "memory that stays the same after the first calls: a sequence has thousands of frames",
            "keep no results or images of earlier frames in self; in torch: inference_mode, or .detach()",
            method,
        )
    return f"{speed}; peak {cost.peak_mb:.0f} MB above start, nothing left behind"
