"""What several kinds are tested with: textured images and pairs of known disparity, threads, equality, cost."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import cv2
import numpy as np
import torch

from bench.authoring.verdict import ContractBrokenError, Note
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.runs.memory import PeakMemory
from bench.types import Image, StereoCamera, StereoFrame

T = TypeVar("T")

FULL_SIZE = (375, 1242)
"""Height and width of KITTI's images, at which speed is told."""
_SECONDS_FOR_COST = 6.0
_MAX_CALLS = 8


def texture(height: int, width: int, seed: int = 0) -> Image:
    """A coloured picture (H, W, 3) uint8 with structure at every scale, as walls and trees have."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, 3))
    for sigma, share in ((1.0, 1.0), (3.0, 1.0), (9.0, 0.8), (27.0, 0.6)):
        layer = cv2.GaussianBlur(rng.standard_normal((height, width, 3)), (0, 0), sigma)
        grey = layer.mean(axis=2, keepdims=True)
        layer = grey / grey.std() + 0.4 * layer / layer.std()
        total += share * layer
    return np.clip(np.rint(128 + 45 * total / total.std()), 0, 255).astype(np.uint8)


def shifted_pair(height: int, width: int, shift: int, seed: int = 0) -> tuple[Image, Image]:
    """A textured wall whose disparity is ``shift`` pixels everywhere: what the left image has at x, the right has at
    x - shift, exactly (cut from one picture, nothing is interpolated)."""
    wide = texture(height, width + shift, seed)
    return wide[:, :width].copy(), wide[:, shift:].copy()


class PairDataset(Dataset):
    """One pair as a data set, with a camera of KITTI's proportions, for plugins that are started with one."""

    label = "pair"
    numbers = (0,)

    def __init__(self, left: Image, right: Image) -> None:
        height, width = left.shape[:2]
        focal = 0.58 * width
        self.camera = StereoCamera(width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5, (0.54, 0.0, 0.0))
        self._frame = StereoFrame(0, 0.0, left, right)

    def frame(self, position: int) -> StereoFrame:
        return self._frame


def in_thread(call: Callable[[], T]) -> T:
    """What ``call`` returns or raises in a background thread, where a run's front end works."""
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="check-plugin") as pool:
        return pool.submit(call).result()


def same_arrays(first: Any, second: Any) -> bool:
    """Whether two arrays (or None) have the same shape, dtype and values; NaN equals NaN."""
    if first is None or second is None:
        return first is second
    floats = np.issubdtype(first.dtype, np.floating)
    return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=bool(floats))


def require_same(first: Any, second: Any, when: str, method: str) -> None:
    """Raise ``ContractBrokenError`` unless both results are equal to the bit; ``when`` says what was done twice."""
    if same_arrays(first, second):
        return
    difference = ""
    if first is not None and second is not None and first.shape == second.shape and first.dtype != bool:
        largest = np.nanmax(np.abs(first.astype(np.float64) - second), initial=0.0)
        difference = f" (largest difference {largest:.3g})"
    raise ContractBrokenError(
        f"{when} gave different results{difference}",
        "the same result to the bit",
        "no randomness but from a seed; reset in start() what is carried from frame to frame; "
        "in torch: model.eval(), torch.inference_mode(), no dropout",
        method,
    )


def require_untouched(what: str, before: Any, after: Any, method: str) -> None:
    """Raise ``ContractBrokenError`` if an input was changed in place."""
    if not same_arrays(before, after):
        raise ContractBrokenError(
            f"{what} was changed in place",
            "inputs stay as they are: other stages use the same arrays",
            f"work on a copy: {what.split(' ')[-1]} = {what.split(' ')[-1]}.copy()",
            method,
        )


def require_array(result: Any, shape: tuple[int, ...], dtype: type, method: str) -> None:
    """Raise ``ContractBrokenError`` unless ``result`` is a numpy array of this shape and dtype."""
    expected = f"numpy array {shape} of {np.dtype(dtype).name}"
    if not isinstance(result, np.ndarray):
        mend = "convert it: result.cpu().numpy()" if isinstance(result, torch.Tensor) else "return a numpy array"
        raise ContractBrokenError(f"{method} returned {_kind_of(result)}", expected, mend, method)
    if result.shape != shape:
        mend = "undo padding and resizing, and take away batch and channel axes: result[0, 0, :height, :width]"
        if result.shape == shape[::-1]:
            mend = "height comes first: transpose it"
        raise ContractBrokenError(f"{method} returned shape {result.shape}", expected, mend, method)
    if result.dtype != dtype:
        mend = f"result.astype(np.{np.dtype(dtype).name}{'_' if dtype is bool else ''})"
        raise ContractBrokenError(f"{method} returned {result.dtype}", expected, mend, method)


def _kind_of(value: Any) -> str:
    return "None (is a return missing?)" if value is None else f"a {type(value).__module__}.{type(value).__name__}"


@dataclass(frozen=True)
class Cost:
    """Of repeated calls: median milliseconds, MB that each call leaves behind (None: not measurable here), peak MB
    above what was resident before."""

    calls: int
    ms: float
    left_mb: list[float] | None
    peak_mb: float


def cost_of(call: Callable[[], object]) -> Cost:
    """Time and memory of a call after one to warm up; a few seconds, or three calls where they take longer."""
    gc.collect()
    before, peak = resident_mb(), PeakMemory()
    call()
    gc.collect()
    times: list[float] = []
    in_use = [allocated_mb()]
    while len(times) < 3 or (len(times) < _MAX_CALLS and sum(times) < _SECONDS_FOR_COST):
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


def weights_of(plugin: Any) -> str:
    """The weight files that the plugin names; ``ContractBrokenError`` for one that is not there."""
    files: dict[str, Path] = getattr(plugin, "weights", dict)()
    for what, file in files.items():
        if not Path(file).is_file():
            raise ContractBrokenError(
                f"weights() names {file} for {what}, which is no file",
                "existing files, for provenance and for the cache",
                "return the paths that were really loaded",
                "weights",
            )
    return ", ".join(f"{what}: {Path(file).name}" for what, file in files.items()) or "none"


def require_frames(dataset: Dataset, least: int) -> None:
    """Raise ``BenchError`` if the data set of the surroundings is too short for a check."""
    if len(dataset) < least:
        raise BenchError(f"The data set {dataset.label} has {len(dataset)} frames; this check needs {least}.")
