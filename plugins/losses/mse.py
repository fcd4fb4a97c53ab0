"""L2 colour loss: what PSNR measures. Not in the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bench.contracts.loss import LossConfig, TorchLoss
from bench.registry import register
from bench.supervision.photometric import Photometric
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class MseConfig(LossConfig):
    """Ours: beside the L1 term, for which an error of 0.5 in one pixel is no worse than of 0.05 in ten."""

    weight: float = 1.0


@register("loss", "mse", config=MseConfig)
class MseLoss(TorchLoss):
    """Mean squared colour error."""

    photometric = Photometric(l2=1.0)

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        return (color - target.image).square().mean()
