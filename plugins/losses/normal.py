"""Normal consistency loss (paper, Eq. 17): value and gradient fused in the C++ core on the CPU, torch elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bench.contracts.loss import CoreLoss, ImageGradients, LossConfig
from bench.contracts.rasterizer import Rendered
from bench.geometry.normals import normals_from_depth
from bench.registry import register
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor

# A pixel's rendered normal means something where the pixel is covered.
COVERED = 0.5


@dataclass(frozen=True)
class NormalConfig(LossConfig):
    """The weight is our reading; the paper gives none."""

    weight: float = 0.1


@register("loss", "normal", config=NormalConfig)
class NormalLoss(CoreLoss):
    """Mean L1 distance of the normals of stereo depth and of rendered depth, where both are valid."""

    def in_core(self, sums: ImageGradients, rendered: Rendered, target: Target, weight: float) -> float:
        import bench._native as _native

        add, view = sums.open(rendered, "depth"), target.view
        intrinsics = (view.fx, view.fy, view.cx, view.cy)
        return _native.normal_loss(
            rendered.depth, rendered.alpha, COVERED, *target.normals, *intrinsics, weight, sums.depth, add
        )

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        rendered, rendered_valid = normals_from_depth(depth, alpha.detach() > COVERED, target.view)
        stereo, stereo_valid = target.normals
        valid = rendered_valid & stereo_valid
        distance = ((rendered - stereo).abs() * valid).sum()
        return distance / torch.clamp(valid.sum(), min=1)
