"""Smoothness loss on the rendered normals (paper, Eq. 18): value and gradient fused in the C++ core on the CPU, torch
elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bench.contracts.loss import CoreLoss, ImageGradients, LossConfig
from bench.contracts.rasterizer import Rendered
from bench.errors import BenchError
from bench.geometry.normals import normals_from_depth
from bench.registry import register
from bench.supervision.target import Target
from plugins.losses.normal import COVERED

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class SmoothConfig(LossConfig):
    """Which neighbours a pixel is compared with."""

    weight: float = 0.5
    distances: tuple[int, ...] = (1,)
    """The neighbours r over which the paper sums, in pixels."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.distances or min(self.distances) < 1:
            raise BenchError(f"loss.smooth.distances={list(self.distances)} must hold positive pixel distances.")


@register("loss", "smooth", config=SmoothConfig)
class SmoothLoss(CoreLoss):
    """Norm of the differences of rendered normals to the neighbours below and to the right, over valid depth values."""

    def in_core(self, sums: ImageGradients, rendered: Rendered, target: Target, weight: float) -> float:
        import bench._native as _native

        add, view = sums.open(rendered, "depth"), target.view
        intrinsics, distances = (view.fx, view.fy, view.cx, view.cy), list(self.config.distances)
        return _native.smooth_loss(
            rendered.depth, rendered.alpha, COVERED, distances, *intrinsics, weight, sums.depth, add
        )

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        normal, valid = normals_from_depth(depth, alpha.detach() > COVERED, target.view)
        total = depth.new_zeros(())
        for r in self.config.distances:
            for axis in (1, 2):
                if r >= normal.shape[axis]:
                    continue
                size = normal.shape[axis] - r
                here, there = normal.narrow(axis, 0, size), normal.narrow(axis, r, size)
                both = valid.narrow(axis - 1, 0, size) & valid.narrow(axis - 1, r, size)
                # The small constant keeps the gradient of the norm finite where two normals are equal.
                total = total + (torch.sqrt(((there - here) ** 2).sum(0) + 1e-12) * both).sum()
        return total / torch.clamp(valid.sum(), min=1)
