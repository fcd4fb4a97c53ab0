"""KITTI's t_rel and r_rel."""

from __future__ import annotations

from typing import Any

from bench.contracts.evaluator import Evaluator
from bench.contracts.metric import Metric
from bench.contracts.saved_run import SavedRun
from bench.evaluation.kitti_odometry import kitti_odometry_error
from bench.evaluation.run_trajectory import estimate_and_truth
from bench.registry import PluginConfig, register

_UNIT = "deg/100m"


@register("evaluator", "kitti_odometry")
class KittiOdometryEvaluator(Evaluator):
    """Drift over segments of 100 to 800 m (10 to 50 m on shorter paths), percent and deg/100 m."""

    metrics = (
        Metric("t_rel_percent", "t_rel", "%", "lower", 2, "trajectory.t_rel_percent", order=30),
        Metric("r_rel_deg_per_100m", "r_rel", _UNIT, "lower", 3, "trajectory.r_rel_deg_per_100m", order=31),
        Metric("t_rel_short_percent", "t_rel 10-50 m", "%", "lower", 2, "trajectory.t_rel_short_percent", order=32),
        Metric(
            "r_rel_short_deg_per_100m", "r_rel 10-50 m", _UNIT, "lower", 3, "trajectory.r_rel_short_deg_per_100m",
            order=33,
        ),
    )  # fmt: skip

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``trajectory.t_rel_percent`` and ``r_rel_deg_per_100m``, or ``t_rel_short_...``, and of which segments."""
        found = estimate_and_truth(run)
        result = found if isinstance(found, str) else kitti_odometry_error(*found)
        if isinstance(result, str):
            nothing = {"t_rel_percent": None, "r_rel_deg_per_100m": None}
            return {"trajectory": nothing, "notes": {"kitti_odometry": result}}
        return {"trajectory": result.metrics()}
