"""Normal consistency loss (paper, Eq. 17): value and gradient fused in the C++ core on the CPU, torch elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bench.contracts.loss import LossConfig, LossValue, TorchLoss, runs_in_core
from bench.contracts.rasterizer import Rendered
from bench.geometry.normals import normals_from_depth
from bench.registry import register
from bench.supervision.target import Target

# A pixel's rendered normal means something where the pixel is covered.
COVERED = 0.5


@dataclass(frozen=True)
class NormalConfig(LossConfig):
    """The weight is our reading; the paper gives none."""

    weight: float = 0.1


@register("loss", "normal", config=NormalConfig)
class NormalLoss(TorchLoss):
    """Mean L1 distance of the normals of stereo depth and of rendered depth, where both are valid."""

    def evaluate(self, rendered: Rendered, target: Target) -> LossValue:
        """Value, and the gradient by depth (H, W); alpha only says where the depth counts."""
        if not runs_in_core(rendered, target):
            return super().evaluate(rendered, target)
        import bench._native as _native

        grad, view = torch.empty_like(rendered.depth), target.view
        normals, valid = target.normals
        value = _native.normal_loss(
            rendered.depth, rendered.alpha, COVERED, normals, valid, view.fx, view.fy, view.cx, view.cy, grad
        )
        return LossValue(value, grad_depth=grad)

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        rendered, rendered_valid = normals_from_depth(depth, alpha.detach() > COVERED, target.view)
        stereo, stereo_valid = target.normals
        valid = rendered_valid & stereo_valid
        distance = ((rendered - stereo).abs() * valid).sum()
        return distance / torch.clamp(valid.sum(), min=1)
