"""Normal consistency loss (paper, Eq. 17)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bench.contracts.loss import LossConfig, TorchLoss
from bench.geometry.normals import normals_from_depth
from bench.mapping.target import Target
from bench.registry import register

# A pixel's rendered normal means something where the pixel is covered.
COVERED = 0.5


@dataclass(frozen=True)
class NormalConfig(LossConfig):
    """The weight is our reading; the paper gives none."""

    weight: float = 0.1


@register("loss", "normal", config=NormalConfig)
class NormalLoss(TorchLoss):
    """Mean L1 distance of the normals of stereo depth and of rendered depth, where both are valid."""

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        rendered, rendered_valid = normals_from_depth(depth, alpha.detach() > COVERED, target.view)
        stereo, stereo_valid = target.normals
        valid = rendered_valid & stereo_valid
        distance = ((rendered - stereo).abs() * valid).sum()
        return distance / torch.clamp(valid.sum(), min=1)
