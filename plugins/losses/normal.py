"""Normal consistency loss (paper, Eq. 17): value and gradient fused in the C++ core on the CPU, torch elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bench.contracts.loss import CoreLoss, ImageGradients, LossConfig
from bench.contracts.rasterizer import Rendered
from bench.errors import BenchError, require_choice
from bench.geometry.normals import FORMS, normals_from_depth
from bench.registry import register
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor

# A pixel's rendered normal means something where the pixel is covered.
COVERED = 0.5


@dataclass(frozen=True)
class SurfaceConfig(LossConfig):
    """How normals are read off a depth image. The core has a kernel for the defaults, torch serves the rest."""

    form: str = "points"
    """points = cross product of back-projected neighbours, slopes = (-dz/du, -dz/dv, 1) of the depth image."""
    step: int = 1
    """The neighbours of which a normal is made lie so many pixels to the right and below."""
    rendered_depth: str = "raw"
    """raw = sum d a T as in the paper's Eq. 3, normalized = divided by alpha."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice(f"loss.{self.name}.form", self.form, FORMS)
        require_choice(f"loss.{self.name}.rendered_depth", self.rendered_depth, ["raw", "normalized"])
        if self.step < 1:
            raise BenchError(f"loss.{self.name}.step={self.step} must be at least 1 pixel.")

    @property
    def has_kernel(self) -> bool:
        """Whether the core makes such normals."""
        return (self.form, self.step, self.rendered_depth) == ("points", 1, "raw")

    def rendered_normals(self, depth: Tensor, alpha: Tensor, target: Target) -> tuple[Tensor, Tensor]:
        """Normals (3, H, W) of the rendered depth, and where they are valid (H, W)."""
        shown = depth / alpha.clamp_min(1e-6) if self.rendered_depth == "normalized" else depth
        return normals_from_depth(shown, alpha.detach() > COVERED, target.view, self.form, self.step)


@dataclass(frozen=True)
class NormalConfig(SurfaceConfig):
    """The weight is the paper's lambda_n."""

    weight: float = 0.1


@register("loss", "normal", config=NormalConfig)
class NormalLoss(CoreLoss):
    """Mean L1 distance of the normals of stereo depth and of rendered depth, where both are valid."""

    @property
    def has_kernel(self) -> bool:
        return bool(self.config.has_kernel)

    def in_core(self, sums: ImageGradients, rendered: Rendered, target: Target, weight: float) -> float:
        import bench._native as _native

        add, view, stereo = sums.open(rendered, "depth"), target.view, target.normals("points", 1)
        intrinsics = (view.fx, view.fy, view.cx, view.cy)
        return _native.normal_loss(
            rendered.depth, rendered.alpha, COVERED, *stereo, *intrinsics, weight, sums.depth, add
        )

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        rendered, rendered_valid = self.config.rendered_normals(depth, alpha, target)
        stereo, stereo_valid = target.normals(self.config.form, self.config.step)
        valid = rendered_valid & stereo_valid
        distance = ((rendered - stereo).abs() * valid).sum()
        return distance / torch.clamp(valid.sum(), min=1)
