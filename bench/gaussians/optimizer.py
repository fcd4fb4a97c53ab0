"""Adam over the parameters of a Gaussian map, only where a view touched them."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from bench import _native
from bench.contracts.rasterizer import Gradients
from bench.gaussians.map import GaussianMap
from bench.gaussians.schema import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, planes_of

BETA1, EPSILON = 0.9, 1e-15
HARMONICS_SHARE = 1 / 20
"""Rate of the harmonics of degree 1 and more, as a share of the colour's (Kerbl et al., 2023)."""


@dataclass(frozen=True)
class LearningRates:
    """Rates per parameter; ``position`` is multiplied by each Gaussian's depth at birth: metres per metre of depth."""

    position: float
    color: float
    opacity: float
    scale: float
    rotation: float

    def per_plane(self, sh_degree: int) -> list[float]:
        """One rate for each plane of a map with harmonics of that degree."""
        rates = [self.color * HARMONICS_SHARE] * planes_of(sh_degree)
        rates[MEAN] = [self.position] * 3
        rates[LOG_SCALE] = [self.scale] * 3
        rates[QUATERNION] = [self.rotation] * 4
        rates[OPACITY_LOGIT] = self.opacity
        rates[COLOR] = [self.color] * 3
        return rates


class MapOptimizer:
    """Adam (Kingma and Ba, 2015) on the map's columns; ``steps`` counts the updates, ``beta2`` is the decay of the
    second moments."""

    def __init__(self, rates: LearningRates, beta2: float = 0.999) -> None:
        self.rates, self._beta2 = rates, beta2
        self.steps = 0

    def step(self, gaussians: GaussianMap, gradients: Gradients) -> None:
        """One update of parameters and moments of the touched Gaussians, in place; their birth depths multiply the
        rate of the positions. Moments and birth depths have M <= N columns: Gaussians from the M-th on are frozen."""
        self.steps += 1
        rates = self.rates.per_plane(gaussians.sh_degree)
        if gaussians.device.type == "cpu":
            _native.adam_step(
                gaussians.planes,
                gaussians.first_moment,
                gaussians.second_moment,
                gradients.planes,
                gaussians.birth_depth,
                rates,
                BETA1,
                self._beta2,
                EPSILON,
                self.steps,
                gradients.touched,
            )
        else:
            self._step_in_torch(gaussians, gradients, rates)

    def _step_in_torch(self, gaussians: GaussianMap, gradients: Gradients, rates: list[float]) -> None:
        learning = gaussians.first_moment.shape[1]
        touched, by_planes = gradients.touched[None, :learning], gradients.planes[:, :learning]
        first = torch.lerp(by_planes, gaussians.first_moment, BETA1)
        second = torch.lerp(by_planes**2, gaussians.second_moment, self._beta2)
        rate = torch.tensor(rates, device=gaussians.device)[:, None].repeat(1, learning)
        rate[MEAN] *= gaussians.birth_depth
        corrected = second / (1 - self._beta2**self.steps)
        update = rate * first / (1 - BETA1**self.steps) / (corrected.sqrt() + EPSILON)
        gaussians.planes[:, :learning].sub_(torch.where(touched, update, 0.0))
        gaussians.first_moment.copy_(torch.where(touched, first, gaussians.first_moment))
        gaussians.second_moment.copy_(torch.where(touched, second, gaussians.second_moment))
