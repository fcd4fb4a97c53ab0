"""A picture of a trajectory against its ground truth: from above, and the errors of each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bench.evaluation.frame_states import stretches
from bench.evaluation.relative_motion import index_in_estimate
from bench.evaluation.rpe import RpeResult
from bench.evaluation.trajectory import AteResult
from bench.io.atomic import atomic_path
from bench.types import Float, Trajectory


def trajectory_figure(ate: AteResult, ground_truth: Trajectory, rpe: RpeResult | None) -> Figure:
    """Left: x and z of the camera centres in the ground truth's world, in metres; right: the errors of each frame.

    The estimate is drawn as aligned for the ATE. Where it was lost its lines have gaps, and the stretch is marked.
    A pair's relative error stands at its later frame; ``rpe`` None leaves the relative errors out.
    """
    figure = Figure(figsize=(11, 6 if rpe else 4.2), layout="constrained")
    rows = ["position", "translation", "rotation"] if rpe else ["position"]
    panels = figure.subplot_mosaic([["above", row] for row in rows])
    _draw_from_above(panels["above"], ate, ground_truth)
    position = _with_gaps(ground_truth, ate.numbers, ate.errors_m)
    curves = {"position": (position, "[m]", f"absolute error of position, RMSE {ate.rmse_m:.3f} m", ate.rmse_m)}
    if rpe is not None:
        means = rpe.metrics()
        over = "to the next frame" if rpe.frame_distance == 1 else f"over {rpe.frame_distance} frames"
        rmse_m, mean_deg = means["rpe_trans_rmse_m"], means["rpe_rot_mean_deg"]
        metres = _with_gaps(ground_truth, rpe.last, rpe.translation_m)
        degrees = _with_gaps(ground_truth, rpe.last, rpe.rotation_deg)
        curves["translation"] = (metres, "[m]", f"error of the motion {over}, RMSE {rmse_m:.4f} m", rmse_m)
        curves["rotation"] = (degrees, "[deg]", f"error of the rotation {over}, mean {mean_deg:.4f} deg", mean_deg)
    lost = stretches(ground_truth.numbers, ~np.isin(ground_truth.numbers, ate.numbers))
    for row, (values, unit, title, average) in curves.items():
        axes = panels[row]
        axes.plot(ground_truth.numbers, values, color="C3", linewidth=1.0)
        axes.axhline(average, color="0.5", linestyle="--")
        axes.set(ylabel=unit, ylim=(0, None))
        axes.set_title(title, fontsize="medium")
        for first, last in lost:
            axes.axvspan(first - 0.5, last + 0.5, color="C3", alpha=0.2, linewidth=0)
    panels[rows[-1]].set_xlabel("frame")
    return figure


def write_trajectory_plot(path: Path, ate: AteResult, ground_truth: Trajectory, rpe: RpeResult | None) -> None:
    """Save ``trajectory_figure`` as PNG, whole or not at all. Needs no display."""
    figure = trajectory_figure(ate, ground_truth, rpe)
    with atomic_path(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def _draw_from_above(axes: Axes, ate: AteResult, ground_truth: Trajectory) -> None:
    truth = ground_truth.T_world_cam[:, :3, 3]
    here = index_in_estimate(ate.aligned, ground_truth)
    path = np.where(here[:, None] >= 0, ate.aligned.T_world_cam[here, :3, 3], np.nan)
    axes.plot(truth[:, 0], truth[:, 2], color="0.6", linewidth=3, label="ground truth")
    axes.plot(path[:, 0], path[:, 2], color="C0", linewidth=1.2, label=f"estimate, {ate.n} frames")
    if (here < 0).any():
        lost = np.where(here[:, None] < 0, truth, np.nan)
        label = f"lost, {(here < 0).sum()} frames"
        axes.plot(lost[:, 0], lost[:, 2], color="C3", marker=".", linewidth=1.2, label=label)
    axes.set(xlabel="x [m]", ylabel="z [m]", title="seen from above")
    axes.axis("equal")
    axes.legend()


def _with_gaps(ground_truth: Trajectory, numbers: np.ndarray, values: Float) -> Float:
    """Values by frame of the ground truth, (N,), NaN for frames that have none: lines break there."""
    filled = np.full(len(ground_truth), np.nan)
    filled[np.searchsorted(ground_truth.numbers, numbers)] = values
    return filled
