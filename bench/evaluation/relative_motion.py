"""Relative motions of an estimate against those of the ground truth: what RPE and KITTI's errors are made of."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.evaluation.trajectory import common_frames
from bench.geometry import se3
from bench.types import Float, Trajectory


def index_in_estimate(estimate: Trajectory, ground_truth: Trajectory) -> npt.NDArray[np.intp]:
    """For each frame of the ground truth its place in the estimate, or -1 where it was lost."""
    _, of_estimate, of_truth = common_frames(estimate, ground_truth)
    here = np.full(len(ground_truth), -1, dtype=np.intp)
    here[of_truth] = of_estimate
    return here


def motion_errors(
    estimate: Trajectory,
    ground_truth: Trajectory,
    here: npt.NDArray[np.intp],
    first: npt.NDArray[np.intp],
    last: npt.NDArray[np.intp],
) -> Float:
    """E = (P_i^-1 P_j)^-1 (G_i^-1 G_j), (P, 4, 4), of pairs of places in the ground truth; ``here`` as above."""
    G, P = ground_truth.T_world_cam, estimate.T_world_cam
    of_truth = se3.inverse(G[first]) @ G[last]
    # (P_i^-1 P_j)^-1 = P_j^-1 P_i
    of_estimate = se3.inverse(P[here[last]]) @ P[here[first]]
    return np.asarray(of_estimate @ of_truth, dtype=np.float64)
