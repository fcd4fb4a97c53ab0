"""KITTI's odometry errors: drift per distance travelled, over segments of fixed lengths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.evaluation.relative_motion import index_in_estimate, motion_errors
from bench.geometry import se3
from bench.types import Float, Trajectory


@dataclass(frozen=True)
class Segments:
    """Which segments of a path are compared: their lengths in metres, and how many frames lie between two starts."""

    lengths_m: tuple[float, ...]
    start_every: int


STANDARD = Segments((100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0), 10)
"""Those of KITTI's development kit."""
SHORT = Segments((10.0, 20.0, 30.0, 40.0, 50.0), 1)
"""For paths that have no 100 m. Their numbers are larger than the standard's and not comparable with them."""


@dataclass(frozen=True)
class SegmentErrors:
    """Errors of P segments: translation as a fraction of the length, rotation in radians per metre.

    ``first`` and ``last`` are frame numbers, ``length_m`` the nominal lengths. ``pairs_lost`` counts the segments that
    the ground truth has and the estimate has not, because its first or last frame was lost.
    """

    segments: Segments
    first: npt.NDArray[np.int64]
    last: npt.NDArray[np.int64]
    length_m: Float
    translation: Float
    rotation_rad_per_m: Float
    pairs_lost: int

    @property
    def t_rel_percent(self) -> float:
        """Mean over all segments, in percent."""
        return float(100.0 * self.translation.mean())

    @property
    def r_rel_deg_per_100m(self) -> float:
        """Mean over all segments, in degrees per 100 m."""
        return float(100.0 * np.rad2deg(self.rotation_rad_per_m.mean()))

    def metrics(self) -> dict[str, Any]:
        """The keys of ``metrics.json``'s ``trajectory``; short segments have names of their own.

        ``segments_m`` are the lengths that the path has, and ``segment_pairs`` how many segments of each.
        """
        lengths, counts = np.unique(self.length_m, return_counts=True)
        which = "_short" if self.segments == SHORT else ""
        return {
            f"t_rel{which}_percent": self.t_rel_percent,
            f"r_rel{which}_deg_per_100m": self.r_rel_deg_per_100m,
            "segments_m": lengths.tolist(),
            "segment_pairs": counts.tolist(),
            "segment_pairs_lost": self.pairs_lost,
            "segment_start_every": self.segments.start_every,
        }


def kitti_odometry_error(estimate: Trajectory, ground_truth: Trajectory) -> SegmentErrors | str:
    """Errors over the standard segments, over the short ones where the path is too short for those; or a reason.

    A path that has 100 m but whose segments are all lost gives the reason, not short segments.
    """
    distance = distance_travelled(ground_truth)
    total = float(distance[-1]) if len(distance) else 0.0
    segments = STANDARD if total > min(STANDARD.lengths_m) else SHORT
    if total <= min(SHORT.lengths_m):
        return f"the path of {total:.1f} m is not longer than the shortest segment, {min(SHORT.lengths_m):.0f} m"
    if not np.isfinite(total):
        return "a pose of the ground truth is not finite"
    return segment_errors(estimate, ground_truth, segments)


def segment_errors(estimate: Trajectory, ground_truth: Trajectory, segments: Segments) -> SegmentErrors | str:
    """Errors of all segments that start at every so many frames, or the reason why there is none.

    The ground truth's frames are the sequence, and its centres say how far the camera went. From each start, for each
    length L, the segment ends at the first frame that is more than L (strictly) down the path; with
    E = (P_i^-1 P_j)^-1 (G_i^-1 G_j) its errors are ||t(E)|| / L and angle(E) / L. Segments that start or end in a lost
    frame are left out and counted. The result is the plain mean over all segments, whatever their length.
    Source: evaluate_odometry.cpp of the development kit of Geiger et al., "Are we ready for autonomous driving? The
    KITTI vision benchmark suite", CVPR 2012.
    """
    distance = distance_travelled(ground_truth)
    starts = np.arange(0, len(distance), segments.start_every)
    lengths = np.array(segments.lengths_m)
    # side="right" finds the first place whose distance is strictly larger.
    last = np.searchsorted(distance, distance[starts, None] + lengths, side="right")
    first = np.broadcast_to(starts[:, None], last.shape)
    length_m = np.broadcast_to(lengths, last.shape)
    there = last < len(distance)
    first, last, length_m = first[there], last[there], length_m[there]
    here = index_in_estimate(estimate, ground_truth)
    tracked = (here[first] >= 0) & (here[last] >= 0)
    pairs_lost = int((~tracked).sum())
    first, last, length_m = first[tracked], last[tracked], length_m[tracked]
    if not len(first):
        return f"no segment starts and ends in tracked frames ({pairs_lost} are lost)"
    E = motion_errors(estimate, ground_truth, here, first, last)
    if not np.isfinite(E).all():
        bad = int(np.argmax(~np.isfinite(E).all(axis=(1, 2))))
        numbers = ground_truth.numbers
        return f"the pose of frame {numbers[first[bad]]} or {numbers[last[bad]]} is not finite"
    return SegmentErrors(
        segments=segments,
        first=ground_truth.numbers[first],
        last=ground_truth.numbers[last],
        length_m=length_m,
        translation=np.linalg.norm(E[:, :3, 3], axis=1) / length_m,
        rotation_rad_per_m=se3.rotation_angle(E[:, :3, :3]) / length_m,
        pairs_lost=pairs_lost,
    )


def distance_travelled(trajectory: Trajectory) -> Float:
    """Length of the path up to each frame, (N,) in metres, starting at 0."""
    steps = np.linalg.norm(np.diff(trajectory.T_world_cam[:, :3, 3], axis=0), axis=1)
    return np.concatenate([np.zeros(min(len(trajectory), 1)), np.cumsum(steps)])
