"""A second rigid motion in the image, such as a lorry alongside whose points outnumber those of the street."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.geometry import se3
from bench.io.torch_files import from_state, to_state
from bench.tracking.descriptors import Ints
from bench.tracking.local_map import LocalMap, View
from bench.tracking.pose_optimization import PoseEstimate, chi_square, optimise_pose
from bench.tracking.relocalise import pose_by_pnp
from bench.types import Float, StereoCamera

_LEAST_SHARE = 0.25
"""Points that a second motion must have, as a share of those that the pose rests on."""
_LOOKED_FOR_FRAMES = 5
"""Frames for which it is looked for after it was seen last."""


class SecondMotion:
    """Finds the largest motion beside the believed one, and the matches that it explains better.

    A second motion is a pose too: the one that the camera would have if its points stood still.
    """

    def __init__(self, camera: StereoCamera, local_map: LocalMap, min_inliers: int) -> None:
        self._camera = camera
        self._map = local_map
        self._min_inliers = min_inliers
        self._step = np.eye(4)
        self._left = 0

    @property
    def expected(self) -> bool:
        """Whether one was there a few frames ago."""
        return self._left > 0

    def drives(self, T_cam_world: Float, T_predicted: Float) -> bool:
        """Whether a pose goes on as the second motion did rather than as predicted (4, 4) for the camera."""
        if not self.expected:
            return False
        second = self._step @ self._map.keyframes[-1].T_cam_world
        far = [np.linalg.norm((T_cam_world @ se3.inverse(T))[:3, 3]) for T in (second, T_predicted)]
        return bool(far[0] < far[1])

    def fade(self) -> None:
        """A frame in which none was seen."""
        self._left = max(self._left - 1, 0)

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        return to_state({"step": self._step, "left": self._left})

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        values = from_state(state)
        self._step, self._left = values["step"], values["left"]

    def find(self, view: View, matched: tuple[Ints, Ints], believed: Ints, T_cam_world: Float) -> PoseEstimate | None:
        """The motion of most of what is left of ``matched``, rows of map points and keypoints (M,), when what agrees
        with the pose ``T_cam_world`` (4, 4) and the rows ``believed`` is taken away; None where that is little.

        It is looked for around the one found last, around "moves as the camera does", and by PnP with RANSAC.
        """
        found = self._largest(view, matched, believed, T_cam_world)
        if found is None or found.inliers.sum() < max(self._min_inliers, _LEAST_SHARE * len(believed)):
            self.fade()
            return None
        self._step = found.T_cam_world @ se3.inverse(self._map.keyframes[-1].T_cam_world)
        self._left = _LOOKED_FOR_FRAMES
        return found

    def _largest(
        self, view: View, matched: tuple[Ints, Ints], believed: Ints, T_cam_world: Float
    ) -> PoseEstimate | None:
        rows, keypoints = matched
        position, observed = self._map.points.position[rows], view.observations(keypoints)
        left = ~np.isin(rows, believed) & ~observed.inliers(chi_square(self._camera, position, observed, T_cam_world))
        position, observed = position[left], observed.take(left)
        if len(position) < self._min_inliers:
            return None
        newest = self._map.keyframes[-1].T_cam_world
        tried = [
            optimise_pose(self._camera, position, observed, T, gate_first=True) for T in (self._step @ newest, newest)
        ]
        by_pnp = pose_by_pnp(self._camera, position, observed.uv)
        if by_pnp is not None:
            tried.append(optimise_pose(self._camera, position, observed, by_pnp))
        return max(tried, key=lambda estimate: int(estimate.inliers.sum()))
