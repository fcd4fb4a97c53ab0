"""Keyframe poses that are optimised with the map: small corrections of the tracker's, which stay the mapper's own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from bench.geometry import se3
from bench.types import Float

if TYPE_CHECKING:
    from torch import Tensor

_BETAS = np.array([0.9, 0.999])
_TURN_PER_METRE = 0.1
"""Radians of turn for a metre of shift: points at ten metres move alike by both."""


class PoseRefinement:
    """Corrections ``T_cam_world -> C T_cam_world`` of keyframes, by Adam on the twist; the first keyframe's is none.

    ``rate`` is in metres a step; 0 leaves all poses as they are. A frame that is no keyframe gets the correction that
    lies between those of its neighbours.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate * np.repeat([1.0, _TURN_PER_METRE], 3)
        self.on = rate > 0
        self._corrections: dict[int, Float] = {}
        self._moments: dict[int, Float] = {}
        self._steps: dict[int, int] = {}

    def add(self, number: int) -> None:
        """A new keyframe: it begins with the correction of the one before."""
        if self.on:
            self._corrections[number] = self._of(number)
            self._moments[number], self._steps[number] = np.zeros((2, 6)), 0

    def corrected(self, number: int, T_world_cam: Float) -> Float:
        """The pose (4, 4) of a frame that the tracker has at ``T_world_cam``."""
        return T_world_cam @ se3.inverse(self._of(number)) if self.on else T_world_cam

    def step(self, number: int, twist: Tensor) -> None:
        """One step of a keyframe against the gradient (6,) by its twist, as ``Rasterizer.backward`` gives it."""
        if number == next(iter(self._corrections)):
            return
        gradient = twist.double().cpu().numpy()
        self._steps[number] += 1
        share = _BETAS[:, None]
        moments = share * self._moments[number] + (1 - share) * np.stack([gradient, gradient**2])
        self._moments[number] = moments
        mean, square = moments / (1 - share ** self._steps[number])
        motion = -self._rate * mean / (np.sqrt(square) + 1e-15)
        self._corrections[number] = se3.exp(motion) @ self._corrections[number]

    def _of(self, number: int) -> Float:
        if number in self._corrections or not self._corrections:
            return self._corrections.get(number, np.eye(4))
        numbers = np.array(sorted(self._corrections))
        after = int(np.searchsorted(numbers, number))
        one, other = int(numbers[max(after - 1, 0)]), int(numbers[min(after, len(numbers) - 1)])
        share = np.array(0.0 if one == other else (number - one) / (other - one))
        return se3.interpolate(self._corrections[one], self._corrections[other], share)

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        return {
            "corrections": {number: torch.from_numpy(C) for number, C in self._corrections.items()},
            "moments": {number: torch.from_numpy(moments) for number, moments in self._moments.items()},
            "steps": dict(self._steps),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave."""
        self._corrections = {number: C.numpy() for number, C in state["corrections"].items()}
        self._moments = {number: moments.numpy() for number, moments in state["moments"].items()}
        self._steps = dict(state["steps"])
