"""Adam over the parameters of a Gaussian map, only where a view touched them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from bench.contracts.rasterizer import Gradients
from bench.gaussians.schema import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, planes_of

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15


@dataclass(frozen=True)
class LearningRates:
    """Rates a parameter; ``position`` is multiplied by each Gaussian's depth at birth, so it is metres a metre of
    depth."""

    position: float
    color: float
    opacity: float
    scale: float
    rotation: float

    def per_plane(self) -> list[float]:
        """One rate a plane, 14 in all."""
        rates = [0.0] * planes_of(0)
        rates[MEAN] = [self.position] * 3
        rates[LOG_SCALE] = [self.scale] * 3
        rates[QUATERNION] = [self.rotation] * 4
        rates[OPACITY_LOGIT] = self.opacity
        rates[COLOR] = [self.color] * 3
        return rates


class MapOptimizer:
    """Adam's two moments (14, N) for a growing and shrinking set of Gaussians (Kingma and Ba, 2015)."""

    def __init__(self, rates: LearningRates, device: torch.device) -> None:
        self._rates = rates.per_plane()
        self._first = torch.zeros(planes_of(0), 0, device=device)
        self._second = torch.zeros(planes_of(0), 0, device=device)
        self._step = 0

    def grow(self, count: int) -> None:
        """Make room for ``count`` new Gaussians, their moments zero."""
        new = self._first.new_zeros(planes_of(0), count)
        self._first = torch.cat([self._first, new], 1)
        self._second = torch.cat([self._second, new], 1)

    def keep(self, mask: Tensor) -> None:
        """Drop the moments of the Gaussians that are not in the (N,) bool mask."""
        self._first, self._second = self._first[:, mask].contiguous(), self._second[:, mask].contiguous()

    def state(self) -> dict[str, Any]:
        """Both moments (14, N) on the CPU and the number of steps."""
        return {"first": self._first.cpu(), "second": self._second.cpu(), "step": self._step}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what ``state`` gave."""
        device = self._first.device
        self._first, self._second = state["first"].to(device), state["second"].to(device)
        self._step = state["step"]

    def rotate(self, planes: slice, which: slice, matrix: Tensor) -> None:
        """The K parameters ``planes`` of the Gaussians ``which`` have been multiplied by an orthogonal (K, K) matrix.

        Gradients turn with the parameters, and so does their mean, the first moment. Of their second moments Adam knows
        only the diagonal; it turns as if the gradient's components were uncorrelated.
        """
        self._first[planes, which] = matrix @ self._first[planes, which]
        self._second[planes, which] = matrix.square() @ self._second[planes, which]

    def step(self, planes: Tensor, gradients: Gradients, position_rate: Tensor) -> None:
        """One update of ``planes`` (14, N) in place; ``position_rate`` (N,) multiplies the rate of the positions."""
        self._step += 1
        if planes.device.type == "cpu":
            import bench._native as _native

            _native.adam_step(
                planes,
                self._first,
                self._second,
                gradients.planes,
                position_rate,
                self._rates,
                BETA1,
                BETA2,
                EPSILON,
                self._step,
                gradients.touched,
            )
            return
        touched = gradients.touched[None]
        first = torch.lerp(gradients.planes, self._first, BETA1)
        second = torch.lerp(gradients.planes**2, self._second, BETA2)
        rates = torch.tensor(self._rates, device=planes.device)[:, None].repeat(1, planes.shape[1])
        rates[MEAN] *= position_rate
        corrected = second / (1 - BETA2**self._step)
        update = rates * first / (1 - BETA1**self._step) / (corrected.sqrt() + EPSILON)
        planes.sub_(torch.where(touched, update, 0.0))
        self._first = torch.where(touched, first, self._first)
        self._second = torch.where(touched, second, self._second)
