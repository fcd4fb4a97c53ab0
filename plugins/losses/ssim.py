"""Structural colour loss (paper, Eq. 14, second term)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bench.contracts.loss import LossConfig, TorchLoss
from bench.registry import register
from bench.supervision.photometric import Photometric
from bench.supervision.ssim import ssim
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class SsimConfig(LossConfig):
    """The paper's lambda_ssim."""

    weight: float = 0.2


@register("loss", "ssim", config=SsimConfig)
class SsimLoss(TorchLoss):
    """1 - mean SSIM, 11x11 Gaussian window as in 3DGS (paper, Eq. 14)."""

    photometric = Photometric(dssim=1.0)

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        return 1.0 - ssim(color, target.image, target.local_statistics)
