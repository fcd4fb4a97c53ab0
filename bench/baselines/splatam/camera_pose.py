"""A camera's pose as SplaTAM optimises it: quaternion and translation of world to camera, by Adam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.geometry import se3
from bench.types import Float

_BETAS, _EPSILON = np.array([[0.9], [0.999]]), 1e-8


@dataclass(frozen=True)
class CameraPose:
    """World to camera: ``quaternion`` (4,) x, y, z, w of any length but zero, ``translation`` (3,) in metres."""

    quaternion: Float
    translation: Float

    @classmethod
    def of_vector(cls, vector: Float) -> CameraPose:
        """The pose of (7,): quaternion, then translation."""
        return cls(vector[:4], vector[4:])

    @property
    def vector(self) -> Float:
        """(7,) quaternion, then translation."""
        return np.concatenate([self.quaternion, self.translation])

    @property
    def T_world_cam(self) -> Float:
        """Camera to world, (4, 4)."""
        return se3.inverse(se3.compose(se3.quaternion_to_rotation(self.quaternion), self.translation))

    def gradient(self, twist: Float) -> Float:
        """Gradient (7,) by quaternion and translation from the one (6,) by the twist p_cam -> exp(twist) p_cam.

        A translation dt moves points as the twist (dt, 0). A turn by w, R -> exp(w) R, moves them by w x (p_cam - t),
        as the twist (t x w, w). The unit quaternion moves by (w, 0) q / 2, so its gradient is 2 (g, 0) q for the
        gradient g by w; it has no part along q, which normalisation would take away, and shrinks with the length of q.
        """
        by_shift, by_turn = twist[:3], twist[3:]
        by_rotation = np.append(by_turn - np.cross(self.translation, by_shift), 0.0)
        length = float(np.linalg.norm(self.quaternion))
        by_quaternion = 2.0 * se3.quaternion_product(by_rotation, self.quaternion / length) / length
        return np.concatenate([by_quaternion, by_shift])


IDENTITY = CameraPose(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))


def extrapolated(before: CameraPose, last: CameraPose) -> CameraPose:
    """Constant velocity as SplaTAM has it: what quaternion and translation changed by, they change by once more."""
    one, two = (pose.quaternion / np.linalg.norm(pose.quaternion) for pose in (last, before))
    ahead = 2.0 * one - two
    return CameraPose(ahead / np.linalg.norm(ahead), 2.0 * last.translation - before.translation)


class PoseOptimizer:
    """Adam (Kingma and Ba, 2015; epsilon 1e-8) over quaternion and translation, from no moments."""

    def __init__(self, rotation_rate: float, translation_rate: float) -> None:
        self._rates = np.repeat([rotation_rate, translation_rate], [4, 3])
        self._moments, self._steps = np.zeros((2, 7)), 0

    def step(self, pose: CameraPose, gradient: Float) -> CameraPose:
        """The pose one update later, from its gradient (7,)."""
        self._steps += 1
        self._moments = _BETAS * self._moments + (1 - _BETAS) * np.stack([gradient, gradient**2])
        mean, square = self._moments / (1 - _BETAS**self._steps)
        return CameraPose.of_vector(pose.vector - self._rates * mean / (np.sqrt(square) + _EPSILON))
