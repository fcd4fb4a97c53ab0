"""Adam over the parameters of a Gaussian map, only where a view touched them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bench import _native
from bench.contracts.rasterizer import AdamStep, Gradients, Rasterizer, Rendered
from bench.gaussians.map import GaussianMap
from bench.gaussians.schema import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, planes_of

if TYPE_CHECKING:
    from torch import Tensor

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
        step = self._next(gaussians)
        if gaussians.device.type != "cpu":
            _step_in_torch(step, gradients)
            return
        _native.adam_step(
            step.planes,
            step.first,
            step.second,
            gradients.planes,
            step.position_rate,
            step.rates,
            step.beta1,
            step.beta2,
            step.epsilon,
            step.step,
            gradients.touched,
        )

    def learn(
        self,
        gaussians: GaussianMap,
        rasterizer: Rasterizer,
        rendered: Rendered,
        by_images: tuple[Tensor | None, Tensor | None, Tensor | None],
        pose: bool = False,
    ) -> Tensor | None:
        """``step`` with the gradients of a loss by the images that were rendered of the Gaussians and, after them, of
        others; gives that by the ``pose``, or None."""
        if rasterizer.learns:
            return rasterizer.learn(rendered, *by_images, self._next(gaussians), pose)
        gradients = rasterizer.backward(rendered, *by_images, pose=pose, learning=len(gaussians))
        self.step(gaussians, gradients)
        return gradients.twist

    def _next(self, gaussians: GaussianMap) -> AdamStep:
        self.steps += 1
        columns = (gaussians.planes, gaussians.first_moment, gaussians.second_moment, gaussians.birth_depth)
        rates = self.rates.per_plane(gaussians.sh_degree)
        return AdamStep(*columns, rates, BETA1, self._beta2, EPSILON, self.steps)


def _step_in_torch(step: AdamStep, gradients: Gradients) -> None:
    learning = step.first.shape[1]
    touched, by_planes = gradients.touched[None, :learning], gradients.planes[:, :learning]
    first = torch.lerp(by_planes, step.first, step.beta1)
    second = torch.lerp(by_planes**2, step.second, step.beta2)
    rate = torch.tensor(step.rates, device=step.planes.device)[:, None].repeat(1, learning)
    rate[MEAN] *= step.position_rate
    corrected = second / (1 - step.beta2**step.step)
    update = rate * first / (1 - step.beta1**step.step) / (corrected.sqrt() + step.epsilon)
    step.planes[:, :learning].sub_(torch.where(touched, update, 0.0))
    step.first.copy_(torch.where(touched, first, step.first))
    step.second.copy_(torch.where(touched, second, step.second))
