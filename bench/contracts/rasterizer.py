"""Contract of a rasterizer: Gaussians and a camera in, colour, depth and alpha out, and gradients back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from bench.errors import BenchError
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor


@dataclass
class Rendered:
    """One render: ``color`` (3, H, W), ``depth`` (H, W) = sum d alpha T in metres, ``alpha`` (H, W) = 1 - final
    transmittance.

    Float32, not clamped, no background. ``context`` belongs to the rasterizer (for ``backward``).
    """

    color: Tensor
    depth: Tensor
    alpha: Tensor
    context: Any = None


@dataclass
class Gradients:
    """Gradients of a scalar loss: ``planes`` (P, M) like the parameters, ``touched`` (M,) bool = visible in this view,
    ``twist`` (6,) float64 of the left perturbation p_cam -> exp(twist) p_cam (translation, rotation), or None.

    M = N, or as many Gaussians as learn. Columns of ``planes`` that were not touched may hold anything: most of a large
    map lies outside a view.
    """

    planes: Tensor
    touched: Tensor
    twist: Tensor | None

    def dense(self) -> Tensor:
        """A copy (P, M) of the gradients, zero where nothing was touched."""
        return torch.where(self.touched, self.planes, 0.0)


@dataclass(frozen=True)
class AdamStep:
    """A step of Adam (Kingma and Ba, 2015) of the first M of the Gaussians that were rendered, of those in view.

    ``planes``, ``first``, ``second`` (P, M): parameters and moments, which change in place. ``rates``: of each plane;
    ``position_rate`` (M,) multiplies that of the means. ``step``: its number, from 1 on.
    """

    planes: Tensor
    first: Tensor
    second: Tensor
    position_rate: Tensor
    rates: list[float]
    beta1: float
    beta2: float
    epsilon: float
    step: int


@dataclass
class Observation:
    """What a view sees: ``pixels`` (N,) int32, in how many pixels a Gaussian is blended (alpha >= 1/255) while the
    transmittance before it is above a half; ``median_depth`` (H, W) float32 in metres, of the Gaussian at which
    transmittance falls to a half or below, NaN where it never does."""

    pixels: Tensor
    median_depth: Tensor


class Rasterizer(ABC):
    """Renders Gaussians by depth-sorted alpha blending (paper, Eqs. 2-4) with gsplat's thresholds, which are
    ``bench.gaussians.schema.THRESHOLDS``. The number of planes says the degree of the spherical harmonics, 0 to 3."""

    device: torch.device
    learns: bool = False
    """Whether it has ``learn``."""

    @abstractmethod
    def render(self, planes: Tensor, view: PinholeView, differentiable: bool = True) -> Rendered:
        """Render (P, N) float32 parameters; ``differentiable=False`` where ``backward`` will not be called.

        The planes may be the front of a larger buffer, ``buffer[:, :N]``: rows are contiguous, the tensor need not be.
        """

    @abstractmethod
    def backward(
        self,
        rendered: Rendered,
        grad_color: Tensor | None,
        grad_depth: Tensor | None,
        grad_alpha: Tensor | None,
        pose: bool = False,
        learning: int | None = None,
    ) -> Gradients:
        """Gradients of a loss from its gradients by the three images (None = zero). Once a render.

        Of the planes only for the first ``learning`` Gaussians (None = all), by the ``pose`` through all of them.
        They may lie in memory that the next call writes again: use them before, or keep ``dense()``.
        """

    def learn(
        self,
        rendered: Rendered,
        grad_color: Tensor | None,
        grad_depth: Tensor | None,
        grad_alpha: Tensor | None,
        step: AdamStep,
        pose: bool = False,
    ) -> Tensor | None:
        """``backward`` and a step with its gradients at once, which then take no memory; the bits are the same.

        Gives the gradient (6,) by the ``pose`` before the step, or None.
        """
        raise NotImplementedError(f"{type(self).__name__} says learns and has no learn()")

    def observe(self, planes: Tensor, view: PinholeView) -> Observation:
        """Which of the (P, N) parameters a view sees, and how far; ``BenchError`` where a rasterizer can't tell."""
        raise BenchError(f"{type(self).__name__} does not tell which Gaussians a view sees. Use mapper.rasterizer=cpu.")
