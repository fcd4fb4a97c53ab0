"""Contract of a rasterizer: Gaussians and a camera in, colour, depth and alpha out, and gradients back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from bench.types import PinholeView


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
    """Gradients of a scalar loss: ``planes`` (P, N) like the parameters, ``touched`` (N,) bool = visible in this view,
    ``twist`` (6,) float64 of the left perturbation p_cam -> exp(twist) p_cam (translation, rotation), or None."""

    planes: Tensor
    touched: Tensor
    twist: Tensor | None


class Rasterizer(ABC):
    """Renders Gaussians by depth-sorted alpha blending (paper, Eqs. 2-4) with these thresholds, those of gsplat:
    nearest depth 0.2 m, 0.3 px^2 low-pass, alpha at least 1/255 and at most 0.999, a pixel ends before transmittance
    falls to 1e-4."""

    device: torch.device

    @abstractmethod
    def render(self, planes: Tensor, view: PinholeView, differentiable: bool = True) -> Rendered:
        """Render (P, N) parameters; ``differentiable=False`` where ``backward`` will not be called."""

    @abstractmethod
    def backward(
        self,
        rendered: Rendered,
        grad_color: Tensor | None,
        grad_depth: Tensor | None,
        grad_alpha: Tensor | None,
        pose: bool = False,
    ) -> Gradients:
        """Gradients of a loss from its gradients by the three images (None = zero). Once a render."""
