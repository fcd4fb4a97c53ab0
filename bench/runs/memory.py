"""Peak memory of a run, in GB of 1e9 bytes."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path

import torch

from bench.process_memory import forget_peaks, peers_peak_gb

_STATUS = Path("/proc/self/status")
_STATM = Path("/proc/self/statm")
# Writing 5 here sets the process's high-water mark back to what is resident now (proc(5), Linux >= 4.0).
_CLEAR_REFS = Path("/proc/self/clear_refs")


class PeakMemory:
    """Measures from construction on: resident memory of this process and its peers (ORB-SLAM3, stereo networks in a
    process of their own), and of the GPU when CUDA is in use.

    Where the kernel does not allow the high-water mark to be reset, the value is that of the process's whole life
    (``getrusage``), and ``since_start`` is False.
    """

    def __init__(self) -> None:
        self.since_start = _reset_high_water_mark()
        forget_peaks()
        if torch.cuda.is_initialized():
            torch.cuda.reset_peak_memory_stats()

    @staticmethod
    def now_gb() -> float | None:
        """What this process occupies now, in GB: of the GPU when CUDA is in use, else resident memory; None where the
        system does not tell."""
        if torch.cuda.is_initialized():
            return torch.cuda.memory_reserved() / 1e9
        if not _STATM.is_file():
            return None
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9

    def host_gb(self) -> float:
        """Peak resident memory of this process, in GB, plus the peaks of its peers."""
        if self.since_start:
            return _high_water_mark_kib() * 1024 / 1e9 + peers_peak_gb()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        # macOS reports bytes, Linux KiB.
        return peak * (1 if sys.platform == "darwin" else 1024) / 1e9 + peers_peak_gb()

    def cuda_gb(self) -> float | None:
        """Peak GPU memory that torch reserved, in GB; None when this process does not use CUDA."""
        return torch.cuda.max_memory_reserved() / 1e9 if torch.cuda.is_initialized() else None

    def peak_gb(self) -> float:
        """What tables call peak memory: the GPU's when CUDA is in use (as papers report it), else the process's."""
        on_gpu = self.cuda_gb()
        return self.host_gb() if on_gpu is None else on_gpu


def _reset_high_water_mark() -> bool:
    try:
        _CLEAR_REFS.write_text("5")
        _high_water_mark_kib()
    except (OSError, ValueError):
        return False
    return True


def _high_water_mark_kib() -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1])
    raise ValueError(f"{_STATUS} has no VmHWM line")
