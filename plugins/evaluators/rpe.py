"""Relative pose error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bench.contracts.evaluator import Evaluator
from bench.contracts.metric import Metric
from bench.contracts.saved_run import SavedRun
from bench.errors import BenchError
from bench.evaluation.rpe import relative_pose_error
from bench.evaluation.run_trajectory import estimate_and_truth
from bench.registry import PluginConfig, register


@dataclass(frozen=True)
class RpeConfig(PluginConfig):
    """Which poses make a pair."""

    frame_distance: int = 1
    """How many frames of the run lie between the two poses of a pair; 1: consecutive."""

    def __post_init__(self) -> None:
        if self.frame_distance < 1:
            raise BenchError(f"evaluator.rpe.frame_distance={self.frame_distance} must be 1 or more.")


@register("evaluator", "rpe", config=RpeConfig)
class RpeEvaluator(Evaluator):
    """Relative pose error of consecutive frames, metres and degrees; lost frames break pairs."""

    metrics = (
        Metric("rpe_trans_rmse_m", "RPE", "m", "lower", 4, "trajectory.rpe_trans_rmse_m", order=20),
        Metric("rpe_rot_mean_deg", "RPE rotation", "deg", "lower", 3, "trajectory.rpe_rot_mean_deg", "never", order=21),
    )

    def __init__(self, config: RpeConfig) -> None:
        self._config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``trajectory.rpe_*`` with the numbers of pairs, used and lost; the later frame's row has a pair's errors."""
        found = estimate_and_truth(run)
        result = found if isinstance(found, str) else relative_pose_error(*found, self._config.frame_distance)
        if isinstance(result, str):
            return {"trajectory": {"rpe_trans_rmse_m": None, "rpe_rot_mean_deg": None}, "notes": {"rpe": result}}
        for number, metres, degrees in zip(result.last, result.translation_m, result.rotation_deg, strict=True):
            run.add_per_frame("left", int(number), rpe_trans_m=float(metres), rpe_rot_deg=float(degrees))
        return {"trajectory": result.metrics()}
