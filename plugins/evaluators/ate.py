"""Absolute trajectory error."""

from __future__ import annotations

from typing import Any

from bench.contracts.evaluator import Evaluator
from bench.contracts.metric import Metric
from bench.contracts.saved_run import SavedRun
from bench.evaluation.hints import hints
from bench.evaluation.rpe import relative_pose_error
from bench.evaluation.run_trajectory import estimate_and_truth
from bench.evaluation.trajectory import absolute_trajectory_error, static_camera_metrics
from bench.registry import PluginConfig, register
from bench.runs.folder import PLOT_FILE


@register("evaluator", "ate")
class AteEvaluator(Evaluator):
    """Absolute trajectory error of all tracked frames after the protocol's alignment, metres."""

    metrics = (Metric("ate_rmse_m", "ATE", "m", "lower", 3, "trajectory.ate_rmse_m", column="always", order=10),)

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``trajectory.ate_rmse_m`` and mean, median, max, number of frames; None and a note without ground truth.

        Beside it ``static_camera_ate_rmse_m``, what a camera that never moves would get; and a note where the two seem
        to be written in different conventions or units.
        """
        found = estimate_and_truth(run)
        if isinstance(found, str):
            return _not_computed(found, run)
        estimate, truth = found
        result = absolute_trajectory_error(estimate, truth, run.protocol.alignment)
        if isinstance(result, str):
            return _not_computed(result, run)
        rpe = relative_pose_error(estimate, truth)
        from bench.report.trajectory_plot import write_trajectory_plot  # matplotlib takes a while to load

        write_trajectory_plot(run.path / PLOT_FILE, result, truth, None if isinstance(rpe, str) else rpe)
        for number, error in zip(result.numbers, result.errors_m, strict=True):
            run.add_per_frame("left", int(number), ate_m=float(error))
        errors = {"trajectory": result.metrics() | static_camera_metrics(truth, result.numbers)}
        doubts = hints(estimate, truth)
        return errors | ({"notes": doubts} if doubts else {})


def _not_computed(reason: str, run: SavedRun) -> dict[str, Any]:
    static = {} if run.ground_truth is None else static_camera_metrics(run.ground_truth, None)
    return {"trajectory": {"ate_rmse_m": None} | static, "notes": {"ate": reason}}
