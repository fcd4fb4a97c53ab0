"""Score a pair of trajectories with the evaluators' own functions, outside any run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.errors import BenchError
from bench.evaluation.frame_states import stretches
from bench.evaluation.hints import hints
from bench.evaluation.kitti_odometry import kitti_odometry_error
from bench.evaluation.rpe import RpeResult, relative_pose_error
from bench.evaluation.trajectory import AteResult, absolute_trajectory_error, static_camera_metrics
from bench.evaluation.trajectory_pair import TrajectoryPair
from bench.protocol import trajectory_stamp


@dataclass(frozen=True)
class Score:
    """``metrics`` in the form of a run's ``metrics.json``, and what a plot needs (``rpe`` None: not computed)."""

    metrics: dict[str, Any]
    ate: AteResult
    rpe: RpeResult | None


def score_pair(pair: TrajectoryPair, alignment: str) -> Score:
    """ATE, RPE, t_rel and r_rel, static camera, and counts of frames; ``BenchError`` when there is no ATE.

    What else can't be computed is None, with the reason in ``metrics["notes"]``.
    """
    truth = pair.ground_truth
    ate = absolute_trajectory_error(pair.estimate, truth, alignment)
    if isinstance(ate, str):
        raise BenchError(f"There is no ATE: {ate}. Check that both files are of the same drive.")
    rpe = relative_pose_error(ate.aligned, truth)
    kitti = kitti_odometry_error(ate.aligned, truth)
    notes = hints(pair.estimate, truth)
    if alignment == "sim3":
        notes.pop("scale", None)  # It is asked for, and in the metrics.
    trajectory = ate.metrics() | static_camera_metrics(truth, ate.numbers)
    if isinstance(rpe, str):
        notes["rpe"] = rpe
        trajectory |= {"rpe_trans_rmse_m": None, "rpe_rot_mean_deg": None}
    else:
        trajectory |= rpe.metrics()
    if isinstance(kitti, str):
        notes["kitti_odometry"] = kitti
        trajectory |= {"t_rel_percent": None, "r_rel_deg_per_100m": None}
    else:
        trajectory |= kitti.metrics()
    if pair.outside:
        notes["outside"] = f"{pair.outside} frames of the ground truth lie before or after the trajectory"
    if pair.without_truth:
        notes["without_truth"] = f"{pair.without_truth} poses of the trajectory have no ground truth and don't count"
    metrics = {
        "protocol": {"name": "score", **trajectory_stamp(alignment), "matched_by": pair.matched_by},
        "trajectory": trajectory,
        "frames": _frame_counts(pair),
        "notes": notes,
    }
    return Score(metrics, ate, None if isinstance(rpe, str) else rpe)


def _frame_counts(pair: TrajectoryPair) -> dict[str, Any]:
    lost = ~np.isin(pair.ground_truth.numbers, pair.estimate.numbers)
    return {
        "total": len(pair.ground_truth),
        "tracked": len(pair.ground_truth) - int(lost.sum()),
        "lost": int(lost.sum()),
        "lost_stretches": stretches(pair.ground_truth.numbers, lost),
        "outside": pair.outside,
        "without_truth": pair.without_truth,
    }
