"""What MonoGS learns of cameras: poses by twists, and exposures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from bench.geometry import se3
from bench.types import Float, Trajectory

if TYPE_CHECKING:
    from bench.baselines.monogs.images import Exposure

_BETAS = np.array([[0.9], [0.999]])
_EPSILON = 1e-8


class CameraAdam:
    """Adam (Kingma and Ba, 2015) over a camera's twist (translation in metres, then rotation in radians) and exposure.

    The twist is 0 before each step, since each step goes into the pose; the moments go on.
    """

    def __init__(self, metres: float, radians: float, exposure: float) -> None:
        self._rates = np.repeat([metres, radians, exposure], [3, 3, 2])
        self._moments, self._steps = np.zeros((2, 8)), 0

    def step(self, by_twist: Float, by_exposure: tuple[float, float]) -> tuple[Float, Exposure]:
        """From the gradients, the twist (6,) to apply and the change of the exposure."""
        gradient = np.concatenate([by_twist, by_exposure])
        self._steps += 1
        self._moments = _BETAS * self._moments + (1 - _BETAS) * np.stack([gradient, gradient**2])
        mean, square = self._moments / (1 - _BETAS**self._steps)
        change = -self._rates * mean / (np.sqrt(square) + _EPSILON)
        return change[:6], (float(change[6]), float(change[7]))


def moved(T_world_cam: Float, twist: Float) -> Float:
    """The pose (4, 4) after T_cam_world <- exp(twist) T_cam_world."""
    return T_world_cam @ se3.exp(-twist)


class KeyframeCameras:
    """Poses and exposures of keyframes, which mapping optimises; the first keyframe's stay.

    The tracker's poses may be corrected by the tracker (loop closure): then the keyframe's own follows. A tracker that
    takes over what ``pose`` says has nothing to correct.
    """

    def __init__(self) -> None:
        self._tracked: dict[int, Float] = {}
        self._poses: dict[int, Float] = {}
        self._exposures: dict[int, Exposure] = {}
        self._learning: dict[int, CameraAdam] = {}

    @property
    def numbers(self) -> list[int]:
        """Keyframes in the order in which they came."""
        return list(self._poses)

    def add(self, number: int, T_world_cam: Float, exposure: Exposure | None) -> None:
        """A new keyframe; without an ``exposure`` it begins with none."""
        self._tracked[number] = self._poses[number] = T_world_cam
        self._exposures[number] = exposure or (0.0, 0.0)

    def pose(self, number: int) -> Float | None:
        """``T_world_cam`` (4, 4) as it is now; None for a frame that is no keyframe."""
        return self._poses.get(number)

    def exposure(self, number: int) -> Exposure:
        """Of a keyframe."""
        return self._exposures[number]

    def begin(self, newest_first: Sequence[int], moving: int, metres: float, radians: float, exposure: float) -> None:
        """These keyframes learn from now on: the first ``moving`` of them pose and exposure, others the exposure."""
        fixed = self.numbers[:1]
        self._learning = {
            number: CameraAdam(metres if place < moving else 0.0, radians if place < moving else 0.0, exposure)
            for place, number in enumerate(newest_first)
            if number not in fixed
        }

    def learns(self, number: int) -> bool:
        """Whether ``step`` would change this keyframe's camera."""
        return number in self._learning

    def step(self, number: int, by_twist: Float, by_exposure: tuple[float, float]) -> None:
        """One step of a keyframe that learns."""
        twist, change = self._learning[number].step(by_twist, by_exposure)
        if twist.any():
            self._poses[number] = moved(self._poses[number], twist)
        a, b = self._exposures[number]
        self._exposures[number] = (a + change[0], b + change[1])

    def follow(self, trajectory: Trajectory) -> dict[int, Float]:
        """Take over the tracker's corrections; the motions (4, 4) in the world by which it moved keyframes."""
        motions = {}
        for number, T_world_cam in zip(trajectory.numbers.tolist(), trajectory.T_world_cam, strict=True):
            own = self._poses.get(number)
            if own is None:
                continue
            if not (np.array_equal(T_world_cam, own) or np.array_equal(T_world_cam, self._tracked[number])):
                motions[number] = T_world_cam @ se3.inverse(self._tracked[number])
                self._poses[number] = motions[number] @ own
            self._tracked[number] = T_world_cam
        return motions

    def corrected(self, number: int, T_world_cam: Float) -> Float:
        """The pose (4, 4) of a frame that the tracker has at ``T_world_cam``: a keyframe's own; of others with the
        correction that lies between those of the keyframes around."""
        if number in self._poses or not self._poses:
            return self._poses.get(number, T_world_cam)
        numbers = np.array(sorted(self._poses))
        after = int(np.searchsorted(numbers, number))
        one, other = int(numbers[max(after - 1, 0)]), int(numbers[min(after, len(numbers) - 1)])
        share = np.array(0.0 if one == other else (number - one) / (other - one))
        return T_world_cam @ se3.interpolate(self._correction(one), self._correction(other), share)

    def _correction(self, number: int) -> Float:
        return se3.inverse(self._tracked[number]) @ self._poses[number]

    def state(self) -> dict[str, Any]:
        """For a checkpoint between two keyframes."""
        return {
            "tracked": {number: torch.from_numpy(T.copy()) for number, T in self._tracked.items()},
            "poses": {number: torch.from_numpy(T.copy()) for number, T in self._poses.items()},
            "exposures": {number: list(exposure) for number, exposure in self._exposures.items()},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave."""
        self._tracked = {number: T.numpy() for number, T in state["tracked"].items()}
        self._poses = {number: T.numpy() for number, T in state["poses"].items()}
        self._exposures = {number: (a, b) for number, (a, b) in state["exposures"].items()}
