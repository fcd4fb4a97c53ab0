"""The odometry between successive keyframes as it was measured, whatever loops have done to the poses since."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.geometry import se3
from bench.tracking.descriptors import Ints
from bench.tracking.growing import Archive, Growing
from bench.tracking.loops.pose_graph import Edge
from bench.types import Float, Mask

_SETTLING = 25
"""Local bundle adjustment moves no keyframe that is older than this many."""
# Random errors of stereo odometry grow with the root of the way: 2 cm and 0.06 degrees after a metre, 0.2 m and 0.6
# degrees after 100 m. ORB-SLAM2 drifts half of that on KITTI; small or dim images drift more.
_SIGMA_M, _SIGMA_RAD = 0.02, np.deg2rad(0.06)
_LEAST_WAY_M = 0.1
_BRIDGE_M, _BRIDGE_RAD, _BRIDGE_SHARE = 1.0, 0.1, 0.3
"""Sigmas of a step on which nothing was seen, bridged at constant velocity: metres plus a share of its length."""
_TIE_M, _TIE_RAD = 0.1, 0.005


class OdometryChain:
    """Steps between keyframes; they follow local bundle adjustment until a loop closes, and never the loop itself."""

    def __init__(self) -> None:
        self._steps = Growing(np.empty((0, 4, 4)))
        self._breaks = Growing(np.empty(0, dtype=bool))
        self._frozen = 0

    @property
    def _T_step(self) -> Float:
        return self._steps.rows

    @property
    def _broken(self) -> Mask:
        return self._breaks.rows

    def extend(self, poses: Float, broken: bool) -> None:
        """Take in a new keyframe. ``poses`` (K, 4, 4) T_world_cam of all keyframes as of now; ``broken`` says that no
        observations tie the newest one to the one before."""
        count = len(poses)
        if count > 1:
            self._steps.append(np.eye(4))
            self._breaks.append(broken)
        first = self._settled()
        self._T_step[first:] = se3.inverse(poses[first:-1]) @ poses[first + 1 :]

    def _settled(self) -> int:
        """Steps that no keyframe to come changes any more."""
        return max(self._frozen, len(self._steps) - _SETTLING, 0)

    def state(self, archive: Archive) -> dict[str, Any]:
        """For a checkpoint."""
        columns = {"T_step": self._T_step, "broken": self._broken}
        return {"frozen": self._frozen, "steps": archive.rows("steps", columns, self._settled())}

    def restore(self, state: dict[str, Any], archive: Archive) -> None:
        """Go on from ``state``."""
        columns = archive.rows_of("steps", state["steps"])
        self._steps, self._breaks = Growing(columns["T_step"]), Growing(columns["broken"])
        self._frozen = state["frozen"]

    def freeze(self) -> None:
        """Keep the steps so far as they are: the poses are about to be corrected."""
        self._frozen = len(self._T_step)

    def steps(self) -> tuple[Float, Float]:
        """Steps (K - 1, 4, 4) and their sigmas (K - 1, 2) in metres and radians."""
        root = np.sqrt(self._lengths() + _LEAST_WAY_M)
        sigma = np.column_stack([_SIGMA_M * root, _SIGMA_RAD * root])
        sigma[self._broken] = np.column_stack([self._bridged(), np.full(int(self._broken.sum()), _BRIDGE_RAD)])
        return self._T_step, sigma

    def way(self, keyframes: Ints, last: int) -> tuple[Float, Float]:
        """Metres of road (n,) from each keyframe (n,) to keyframe ``last``, and by how many metres (n,), three sigmas
        each, bridged steps on it may be off."""
        metres = np.append(0.0, np.cumsum(self._lengths()))
        slack = np.zeros(len(metres))
        slack[1:][self._broken] = 3.0 * self._bridged()
        slack = np.cumsum(slack)
        return metres[last] - metres[keyframes], slack[last] - slack[keyframes]

    def tie(self, place: int, keyframe: int, poses: Float) -> Edge:
        """The edge that a relocalisation makes: keyframe ``keyframe`` was put where it sees keyframe ``place``."""
        covariance = np.diag([_TIE_M**2] * 3 + [_TIE_RAD**2] * 3)
        return Edge(place, keyframe, se3.inverse(poses[place]) @ poses[keyframe], covariance)

    def _bridged(self) -> Float:
        """Sigma in metres of each broken step."""
        return _BRIDGE_M + _BRIDGE_SHARE * self._lengths()[self._broken]

    def _lengths(self) -> Float:
        return np.linalg.norm(self._T_step[:, :3, 3], axis=1)
