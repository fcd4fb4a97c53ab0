"""Edge-weighted geometric loss against stereo depth (paper, Eqs. 15 and 16): fused in the C++ core on the CPU, torch
elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from bench.contracts.loss import LossConfig, LossTerm, LossValue, runs_in_core
from bench.contracts.rasterizer import Rendered
from bench.errors import BenchError, require_choice
from bench.registry import register
from bench.supervision.target import Target


@dataclass(frozen=True)
class GeoConfig(LossConfig):
    """Which pixels count, how much, and which rendered depth is compared."""

    weight: float = 0.1
    stride: int = 2
    """2 takes a quarter of the pixels on a regular grid (the paper's S), 1 takes all ("with ds")."""
    edge_weighted: bool = True
    """Multiply by g = exp(-|grad I|)."""
    rendered_depth: str = "raw"
    """raw = sum d a T as in the paper's Eq. 3, normalized = divided by alpha."""

    def __post_init__(self) -> None:
        if self.stride < 1:
            raise BenchError(f"loss.geo.stride={self.stride} must be at least 1 (1 = every pixel, 2 = a quarter).")
        require_choice("loss.geo.rendered_depth", self.rendered_depth, ["raw", "normalized"])


@register("loss", "geo", config=GeoConfig)
class GeoLoss(LossTerm):
    """Mean over a pixel grid of g log(1 + M |D - D_rendered|) (paper, sampled geometric loss)."""

    def evaluate(self, rendered: Rendered, target: Target) -> LossValue:
        """Value, and the gradients (H, W) by depth and, for normalized depth, by alpha."""
        return self._in_core(rendered, target) if runs_in_core(rendered, target) else self._in_torch(rendered, target)

    def _in_core(self, rendered: Rendered, target: Target) -> LossValue:
        import bench._native as _native

        normalized = self.config.rendered_depth == "normalized"
        grad_depth = torch.empty_like(rendered.depth)
        grad_alpha = torch.empty_like(rendered.alpha) if normalized else None
        value = _native.geo_loss(
            rendered.depth,
            rendered.alpha if normalized else None,
            target.depth,
            target.depth_mask,
            target.edge_weight if self.config.edge_weighted else None,
            self.config.stride,
            grad_depth,
            grad_alpha,
        )
        return LossValue(value, grad_depth=grad_depth, grad_alpha=grad_alpha)

    def _in_torch(self, rendered: Rendered, target: Target) -> LossValue:
        grid = (slice(None, None, self.config.stride),) * 2
        mask = target.depth_mask[grid]
        depth, alpha = rendered.depth[grid], rendered.alpha[grid]
        normalized = self.config.rendered_depth == "normalized"
        shown = depth / alpha.clamp_min(1e-6) if normalized else depth
        difference = (shown - target.depth[grid]) * mask
        distance = difference.abs()
        weight = target.edge_weight[grid] / mask.numel() if self.config.edge_weighted else 1.0 / mask.numel()
        value = (weight * torch.log1p(distance)).sum()
        by_shown = weight * torch.sign(difference) / (1.0 + distance)
        grad_depth = torch.zeros_like(rendered.depth)
        if not normalized:
            grad_depth[grid] = by_shown
            return LossValue(float(value), grad_depth=grad_depth)
        grad_alpha = torch.zeros_like(rendered.alpha)
        grad_depth[grid] = by_shown / alpha.clamp_min(1e-6)
        grad_alpha[grid] = torch.where(alpha > 1e-6, -by_shown * shown / alpha.clamp_min(1e-6), 0.0)
        return LossValue(float(value), grad_depth=grad_depth, grad_alpha=grad_alpha)
