"""Memory and time, as the run measured them."""

from __future__ import annotations

from typing import Any

from bench.contracts.evaluator import Evaluator
from bench.contracts.metric import Metric
from bench.contracts.saved_run import SavedRun
from bench.registry import PluginConfig, register
from bench.runs.folder import RESOURCES_FILE

_STAGES = ("tracking", "stereo", "mapping")
REPORTED = ("peak_memory_gb", *(f"{stage}_s_per_frame" for stage in _STAGES), "wall_s_per_frame")


@register("evaluator", "resources")
class ResourcesEvaluator(Evaluator):
    """Peak memory in GB, and seconds per frame of tracking, stereo and mapping."""

    metrics = (
        Metric("gaussians", "Gaussians", "", None, None, "map.gaussians", order=70),
        Metric(
            "peak_memory_gb", "Memory", "GB", "lower", 2, "resources.peak_memory_gb", "always", of_part=False, order=80
        ),
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

        Another note says when depth came from the disk cache: its seconds are those of when it was computed.
        """
        if not (run.path / RESOURCES_FILE).is_file():
            note = "the run stopped before it saved its resources"
            return {"resources": dict.fromkeys(REPORTED), "notes": {"resources": note}}
        metrics: dict[str, Any] = {"resources": {name: run.resources.get(name) for name in REPORTED}}
        stereo, tracking = (run.resources.get(f"{what}_cached_frames") for what in ("stereo", "tracking"))
        parts = [f"stereo or sky of {stereo} frames"] if stereo else []
        parts += [f"tracking of {tracking} frames"] if tracking else []
        if parts:
            metrics["notes"] = {
                "resources": f"{' and '.join(parts)} came from the cache: their time is that of computing them, "
                "recorded then; wall time and peak memory are without it (cache.enabled=false measures all)"
            }
        return metrics
