"""Smoothness loss on the rendered normals (paper, Eq. 18): value and gradient fused in the C++ core on the CPU, torch
elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bench.contracts.loss import CoreLoss, ImageGradients
from bench.contracts.rasterizer import Rendered
from bench.errors import BenchError, require_choice, require_least
from bench.registry import register
from bench.supervision.target import Target

from .normal import COVERED, SurfaceConfig

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class SmoothConfig(SurfaceConfig):
    """Which neighbours a pixel is compared with, where, and how much an edge between them excuses."""

    weight: float = 0.5
    distances: tuple[int, ...] = (1,)
    """The neighbours r over which the paper sums, in pixels."""
    squared: bool = False
    """Take the norm's square: small differences, as of noise, count for little."""
    pixels: str = "covered"
    """Where normals count: covered = wherever the map covers the pixel, supervised = only in the paper's mask M."""
    edges: str = "none"
    """What weakens the term between two pixels: color = exp(-edge_scale |I' - I|), I grey in [0, 1]; depth =
    exp(-edge_scale |D' - D| / min(D', D)) of the stereo depth, 1 where that is unknown; none."""
    edge_scale: float = 10.0
    """How fast an edge weakens the term."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.distances or min(self.distances) < 1:
            raise BenchError(f"loss.smooth.distances={list(self.distances)} must hold positive pixel distances.")
        require_choice("loss.smooth.pixels", self.pixels, ["covered", "supervised"])
        require_choice("loss.smooth.edges", self.edges, ["none", "color", "depth"])
        require_least("loss.smooth", self, edge_scale=0)

    @property
    def has_kernel(self) -> bool:
        return super().has_kernel and (self.squared, self.pixels, self.edges) == (False, "covered", "none")


@register("loss", "smooth", config=SmoothConfig)
class SmoothLoss(CoreLoss):
    """Norm of the differences of rendered normals to the neighbours below and to the right, over valid depth values."""

    @property
    def has_kernel(self) -> bool:
        return bool(self.config.has_kernel)

    def in_core(self, sums: ImageGradients, rendered: Rendered, target: Target, weight: float) -> float:
        import bench._native as _native

        add, view = sums.open(rendered, "depth"), target.view
        intrinsics, distances = (view.fx, view.fy, view.cx, view.cy), list(self.config.distances)
        return _native.smooth_loss(
            rendered.depth, rendered.alpha, COVERED, distances, *intrinsics, weight, sums.depth, add
        )

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        normal, valid = self.config.rendered_normals(depth, alpha, target)
        if self.config.pixels == "supervised":
            valid = valid & target.depth_mask
        total = depth.new_zeros(())
        for r in self.config.distances:
            for axis in (0, 1):
                if r >= valid.shape[axis]:
                    continue
                here, there = (part(normal, axis + 1, r) for part in (_first, _last))
                both = _first(valid, axis, r) & _last(valid, axis, r)
                size = ((there - here) ** 2).sum(0)
                if not self.config.squared:
                    # The small constant keeps the gradient of the norm finite where two normals are equal.
                    size = torch.sqrt(size + 1e-12)
                total = total + (size * both * self._excuse(target, axis, r)).sum()
        return total / torch.clamp(valid.sum(), min=1)

    def _excuse(self, target: Target, axis: int, r: int) -> Tensor | float:
        """The factor of each pixel and its neighbour at distance ``r`` along ``axis``, from 0 (an edge) to 1."""
        if self.config.edges == "none":
            return 1.0
        values = target.image.mean(0) if self.config.edges == "color" else target.depth
        here, there = _first(values, axis, r), _last(values, axis, r)
        edge = (there - here).abs()
        if self.config.edges == "depth":
            nearer = torch.minimum(here, there)
            edge = torch.where(nearer > 0, edge / nearer.clamp_min(1e-6), 0.0)
        return torch.exp(-self.config.edge_scale * edge)


def _first(image: Tensor, axis: int, r: int) -> Tensor:
    """All but the last ``r`` rows or columns."""
    return image.narrow(axis, 0, image.shape[axis] - r)


def _last(image: Tensor, axis: int, r: int) -> Tensor:
    """All but the first ``r`` rows or columns."""
    return image.narrow(axis, r, image.shape[axis] - r)
