"""Memory and time, as the run measured them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bench.contracts.evaluator import Evaluator
from bench.contracts.metric import Metric
from bench.contracts.saved_run import SavedRun
from bench.registry import PluginConfig, register
from bench.runs.folder import RESOURCES_FILE

_STAGES = ("tracking", "stereo", "mapping")
_LEAST_FRAMES = 10
_FULL_GB = 48.0
_OF_GROWTH = ("memory_growth_mb_per_frame", "frames_to_48_gb")
REPORTED = ("peak_memory_gb", *(f"{stage}_s_per_frame" for stage in _STAGES), "wall_s_per_frame")


@register("evaluator", "resources")
class ResourcesEvaluator(Evaluator):
    """Peak memory in GB and its growth, and seconds per frame of tracking, stereo and mapping."""

    metrics = (
        Metric("gaussians", "Gaussians", "", None, None, "map.gaussians", order=70),
        Metric(
            "peak_memory_gb", "Memory", "GB", "lower", 2, "resources.peak_memory_gb", "always", of_part=False, order=80
        ),
        Metric(
            "memory_growth_mb_per_frame", "Memory growth", "MB/frame", "lower", 2,
            "resources.memory_growth_mb_per_frame", "never",
        ),
        Metric("frames_to_48_gb", "Frames to 48 GB", "", "higher", None, "resources.frames_to_48_gb", "never"),
        Metric(
            "s_per_frame", "Time", "s/frame", "lower", 2,
            " + ".join(f"resources.{stage}_s_per_frame" for stage in _STAGES), "always", order=90,
        ),
        *(
            Metric(f"{stage}_s_per_frame", title, "s/frame", "lower", 3, f"resources.{stage}_s_per_frame", "never")
            for stage, title in zip((*_STAGES, "wall"), ("Tracking", "Stereo", "Mapping", "Wall time"), strict=True)
        ),
    )  # fmt: skip

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``resources`` with the measured values; None and a note when the run stopped before it saved them.

        Growth is that of a line through what the process occupied after each frame of the second half, and frames to
        48 GB are where that line gets there. Another note says when depth came from the disk cache: its seconds are
        those of when it was computed.
        """
        if not (run.path / RESOURCES_FILE).is_file():
            note = "the run stopped before it saved its resources"
            return {"resources": dict.fromkeys((*REPORTED, *_OF_GROWTH)), "notes": {"resources": note}}
        measured = {name: run.resources.get(name) for name in REPORTED}
        metrics: dict[str, Any] = {"resources": measured | memory_growth(run.frames)}
        stereo, tracking = (run.resources.get(f"{what}_cached_frames") for what in ("stereo", "tracking"))
        parts = [f"stereo or sky of {stereo} frames"] if stereo else []
        parts += [f"tracking of {tracking} frames"] if tracking else []
        if parts:
            metrics["notes"] = {
                "resources": f"{' and '.join(parts)} came from the cache: their time is that of computing them, "
                "recorded then; wall time and peak memory are without it (cache.enabled=false measures all)"
            }
        return metrics


def memory_growth(frames: pd.DataFrame) -> dict[str, float | None]:
    """Megabytes that each frame adds, and the number of frames at which 48 GB would be full; None where that is not
    known or never.

    ``frames`` has the column memory_gb: what the process occupied after each of them.
    """
    unknown: dict[str, float | None] = dict.fromkeys(_OF_GROWTH)
    if "memory_gb" not in frames or len(frames) < _LEAST_FRAMES:
        return unknown
    used = pd.to_numeric(frames["memory_gb"], errors="coerce").to_numpy(float)
    if not np.isfinite(used).all():
        return unknown
    # The first half holds what is loaded once.
    place = np.arange(len(used))[len(used) // 2 :]
    slope, start = np.polyfit(place, used[place], 1)
    full = (_FULL_GB - start) / slope + 1 if slope > 0 else None
    return {"memory_growth_mb_per_frame": 1000.0 * float(slope), "frames_to_48_gb": full and float(round(full))}
