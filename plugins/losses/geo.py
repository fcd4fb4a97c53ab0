"""Edge-weighted geometric loss against stereo depth (paper, Eqs. 15 and 16): fused in the C++ core on the CPU, torch
elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bench.contracts.loss import CoreLoss, ImageGradients, LossConfig
from bench.contracts.rasterizer import Rendered
from bench.errors import BenchError, require_choice
from bench.registry import register
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class GeoConfig(LossConfig):
    """Which pixels count, how much, and which rendered depth is compared."""

    weight: float = 0.1
    stride: int = 2
    """2 takes a quarter of the pixels on a regular grid (the paper's S), 1 takes all ("with ds")."""
    edge_weighted: bool = True
    """Multiply by g = exp(-|grad I|)."""
    confidence_weighted: bool = False
    """Multiply by the stereo plugin's confidence in its depth, too."""
    rendered_depth: str = "raw"
    """raw = sum d a T as in the paper's Eq. 3, normalized = divided by alpha."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stride < 1:
            raise BenchError(f"loss.geo.stride={self.stride} must be at least 1 (1 = every pixel, 2 = a quarter).")
        require_choice("loss.geo.rendered_depth", self.rendered_depth, ["raw", "normalized"])


@register("loss", "geo", config=GeoConfig)
class GeoLoss(CoreLoss):
    """Mean over a pixel grid of g log(1 + M |D - D_rendered|) (paper, sampled geometric loss)."""

    def in_core(self, sums: ImageGradients, rendered: Rendered, target: Target, weight: float) -> float:
        import bench._native as _native

        normalized = self.config.rendered_depth == "normalized"
        add = sums.open(rendered, "depth", "alpha") if normalized else sums.open(rendered, "depth")
        return _native.geo_loss(
            rendered.depth,
            rendered.alpha if normalized else None,
            target.depth,
            target.depth_mask,
            self._weight(target),
            self.config.stride,
            weight,
            sums.depth,
            sums.alpha if normalized else None,
            add,
        )

    def _weight(self, target: Target) -> Tensor | None:
        """What multiplies each pixel's term, (H, W); None = 1. ``BenchError`` where the confidence is missing."""
        if not self.config.confidence_weighted:
            return target.edge_weight if self.config.edge_weighted else None
        if target.confidence is None:
            raise BenchError(
                "loss.geo.confidence_weighted=true: the stereo plugin gives no confidence. Use one that does, such as "
                "stereo=sgbm stereo.full_check=true or a network with stereo.left_right_check_px=1."
            )
        return target.confident_edge_weight if self.config.edge_weighted else target.confidence

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        grid = (slice(None, None, self.config.stride),) * 2
        mask = target.depth_mask[grid]
        shown = depth[grid]
        if self.config.rendered_depth == "normalized":
            shown = shown / alpha[grid].clamp_min(1e-6)
        distance = ((shown - target.depth[grid]) * mask).abs()
        of_pixel = self._weight(target)
        weight = 1.0 if of_pixel is None else of_pixel[grid]
        return (weight * torch.log1p(distance)).sum() / mask.numel()
