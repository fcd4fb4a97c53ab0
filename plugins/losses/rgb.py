"""L1 colour loss (paper, Eq. 14, first term)."""

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
class RgbConfig(LossConfig):
    """The paper's lambda_rgb."""

    weight: float = 0.8


@register("loss", "rgb", config=RgbConfig)
class RgbLoss(TorchLoss):
    """Mean absolute colour error (paper, Eq. 14)."""

    photometric = Photometric(l1=1.0)

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        return (color - target.image).abs().mean()
