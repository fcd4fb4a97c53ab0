"""Relative pose error: how well an estimate tells the motion from one frame to the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.evaluation.relative_motion import index_in_estimate, motion_errors
from bench.geometry import se3
from bench.types import Float, Trajectory


@dataclass(frozen=True)
class RpeResult:
    """Error of the motion from frame ``first[i]`` to frame ``last[i]``: metres and degrees, each (P,).

    ``frame_distance`` is the distance of the two, counted in frames of the sequence. ``pairs_lost`` counts the pairs
    that the ground truth has and the estimate has not, because one of the two frames was lost.
    """

    translation_m: Float
    rotation_deg: Float
    first: npt.NDArray[np.int64]
    last: npt.NDArray[np.int64]
    frame_distance: int
    pairs_lost: int

    def metrics(self) -> dict[str, Any]:
        """The RPE's keys of ``metrics.json``'s ``trajectory``."""
        return {
            "rpe_trans_rmse_m": float(np.sqrt(np.mean(self.translation_m**2))),
            "rpe_trans_mean_m": float(self.translation_m.mean()),
            "rpe_rot_rmse_deg": float(np.sqrt(np.mean(self.rotation_deg**2))),
            "rpe_rot_mean_deg": float(self.rotation_deg.mean()),
            "rpe_frame_distance": self.frame_distance,
            "rpe_pairs": len(self.first),
            "rpe_pairs_lost": self.pairs_lost,
        }


def relative_pose_error(estimate: Trajectory, ground_truth: Trajectory, frame_distance: int = 1) -> RpeResult | str:
    """RPE over all pairs of frames ``frame_distance`` apart, or the reason why there is none.

    The ground truth's frames are the sequence. A pair of which the estimate lacks a frame is left out and counted,
    never bridged; so is, without being counted, one over a gap in the ground truth's own frame numbers. With
    E = (P_i^-1 P_j)^-1 (G_i^-1 G_j) the errors are the length of E's translation and the angle of its rotation.
    Moving either trajectory as a whole changes nothing, so no alignment is needed (but for a scale).
    Source: Sturm et al., IROS 2012, Sec. V, for each pair of frames on its own.
    """
    numbers = ground_truth.numbers
    if len(numbers) <= frame_distance:
        return f"the ground truth has {len(numbers)} frames, too few for a pair {frame_distance} apart"
    first = np.arange(len(numbers) - frame_distance)
    whole = numbers[frame_distance:] - numbers[:-frame_distance] == frame_distance * np.diff(numbers).min()
    first = first[whole]
    here = index_in_estimate(estimate, ground_truth)
    tracked = (here[first] >= 0) & (here[first + frame_distance] >= 0)
    pairs_lost = int((~tracked).sum())
    first = first[tracked]
    last = first + frame_distance
    if not len(first):
        return f"no two tracked frames are {frame_distance} apart ({pairs_lost} pairs are lost)"
    E = motion_errors(estimate, ground_truth, here, first, last)
    if not np.isfinite(E).all():
        bad = int(np.argmax(~np.isfinite(E).all(axis=(1, 2))))
        return f"the pose of frame {numbers[first[bad]]} or {numbers[last[bad]]} is not finite"
    return RpeResult(
        translation_m=np.linalg.norm(E[:, :3, 3], axis=1),
        rotation_deg=np.rad2deg(se3.rotation_angle(E[:, :3, :3])),
        first=numbers[first],
        last=numbers[last],
        frame_distance=frame_distance,
        pairs_lost=pairs_lost,
    )
