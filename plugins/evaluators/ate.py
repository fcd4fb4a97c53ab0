"""Absolute trajectory error."""

from __future__ import annotations

from typing import Any

from bench.contracts.evaluator import Evaluator
from bench.evaluation.trajectory import absolute_trajectory_error
from bench.registry import PluginConfig, register
from bench.report.trajectory_plot import write_trajectory_plot
from bench.runs.folder import PLOT_FILE, TRAJECTORY_FILE
from bench.runs.saved import SavedRun


@register("evaluator", "ate")
class AteEvaluator(Evaluator):
    """Absolute trajectory error of all tracked frames after SE(3) alignment, metres."""

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``trajectory.ate_rmse_m`` and mean, median, max, number of frames; None and a note without ground truth."""
        if run.status.state != "done" and not (run.path / TRAJECTORY_FILE).is_file():
            return _not_computed("the run stopped before it saved its trajectory")
        if run.ground_truth is None:
            return _not_computed("the data set gives no ground-truth poses")
        result = absolute_trajectory_error(run.trajectory, run.ground_truth, run.protocol.alignment)
        if isinstance(result, str):
            return _not_computed(result)
        aligned = run.protocol.alignment == "se3"
        write_trajectory_plot(run.path / PLOT_FILE, run.trajectory, run.ground_truth, result, aligned)
        for number, error in zip(result.numbers, result.errors_m, strict=True):
            run.add_per_frame("left", int(number), ate_m=float(error))
        return {
            "trajectory": {
                "ate_rmse_m": result.rmse_m,
                "ate_mean_m": result.mean_m,
                "ate_median_m": result.median_m,
                "ate_max_m": result.max_m,
                "n": result.n,
            }
        }


def _not_computed(reason: str) -> dict[str, Any]:
    return {"trajectory": {"ate_rmse_m": None}, "notes": {"ate": reason}}
