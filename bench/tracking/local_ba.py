"""Bundle adjustment over a window of keyframes and the points they see, by the Schur complement."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench import _native
from bench.geometry import se3
from bench.tracking.descriptors import Ints
from bench.tracking.pose_optimization import Observations, camera_numbers
from bench.types import Float, Mask, StereoCamera


@dataclass(frozen=True)
class Problem:
    """K keyframe poses ``T_cam_world`` (K, 4, 4), the first ``fixed`` of them held; P ``points`` (P, 3); M observations
    of point ``point[m]`` in keyframe ``keyframe[m]``, sorted by keyframe, at most one of a point in each."""

    T_cam_world: Float
    fixed: int
    points: Float
    keyframe: Ints
    point: Ints
    observed: Observations

    @cached_property
    def blocks(self) -> list[slice]:
        """Where in the observations each keyframe's lie."""
        edges = np.searchsorted(self.keyframe, np.arange(len(self.T_cam_world) + 1))
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]


@dataclass(frozen=True)
class Solution:
    """Optimised poses (K, 4, 4) and points (P, 3); ``inliers`` (M,) pass their chi-square gate."""

    T_cam_world: Float
    points: Float
    inliers: Mask


def solve(camera: StereoCamera, problem: Problem, iterations: tuple[int, ...] = (3, 3)) -> Solution:
    """Levenberg-Marquardt with Huber's loss; paper, Eq. "local BA" (window and gates as in ORB-SLAM2, 2017).

    Each entry of ``iterations`` is a round; after it, observations beyond their gate are left out of the next one.
    Points that end up with a single mono observation keep their place through the damping. Poses with index below
    ``fixed`` come back unchanged. A step that raises the cost is undone, so the cost never grows within a round.
    """
    T, points, inliers = _native.bundle_adjust(
        camera_numbers(camera),
        problem.T_cam_world,
        problem.fixed,
        problem.points,
        problem.keyframe,
        problem.point,
        problem.observed.table,
        list(iterations),
    )
    T[problem.fixed :] = se3.orthonormalise(T[problem.fixed :])
    return Solution(T, points, inliers.astype(bool))
