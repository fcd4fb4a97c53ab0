"""A picture of a trajectory against its ground truth: from above, and the error of each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bench.evaluation.trajectory import AteResult, umeyama_se3
from bench.runs.atomic import atomic_path
from bench.types import Trajectory


def trajectory_figure(estimate: Trajectory, ground_truth: Trajectory, ate: AteResult, aligned: bool) -> Figure:
    """Left: x and z of the camera centres in the ground truth's world, in metres; right: the error of each frame.

    ``aligned``: the estimate is moved onto the ground truth first (SE(3), no scale), as for the ATE.
    """
    common, here, there = np.intersect1d(estimate.numbers, ground_truth.numbers, return_indices=True)
    path, truth = estimate.T_world_cam[here, :3, 3], ground_truth.T_world_cam[there, :3, 3]
    if aligned:
        R, t = umeyama_se3(path, truth)
        path = path @ R.T + t
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    above, errors = figure.subplots(1, 2)
    above.plot(truth[:, 0], truth[:, 2], color="0.6", linewidth=3, label="ground truth")
    above.plot(path[:, 0], path[:, 2], color="C0", linewidth=1.2, label=f"estimate, {len(common)} frames")
    above.set(xlabel="x [m]", ylabel="z [m]", title="seen from above")
    above.axis("equal")
    above.legend()
    errors.plot(ate.numbers, ate.errors_m, color="C3", linewidth=1.2)
    errors.axhline(ate.rmse_m, color="0.6", linestyle="--", label=f"RMSE {ate.rmse_m:.3f} m")
    errors.set(xlabel="frame", ylabel="position error [m]", title="absolute trajectory error", ylim=(0, None))
    errors.legend()
    return figure


def write_trajectory_plot(
    path: Path, estimate: Trajectory, ground_truth: Trajectory, ate: AteResult, aligned: bool
) -> None:
    """Save ``trajectory_figure`` as PNG, whole or not at all. Needs no display."""
    figure = trajectory_figure(estimate, ground_truth, ate, aligned)
    with atomic_path(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))
