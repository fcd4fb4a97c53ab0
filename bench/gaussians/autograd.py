"""Base of rasterizers whose gradients come from torch's autograd."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import torch

from bench.contracts.rasterizer import Gradients, Rasterizer, Rendered
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor


class AutogradRasterizer(Rasterizer):
    """An author writes ``splat``, differentiable by the planes and by the twist; the rest follows.

    ``precision`` names the dtype that ``splat`` computes in; images and gradients come back in the dtype of the planes
    that were given, so an oracle in float64 serves mapping (float32) too.
    """

    precision = "float32"

    @property
    def dtype(self) -> torch.dtype:
        """What ``splat`` is given."""
        dtype: torch.dtype = getattr(torch, self.precision)
        return dtype

    @abstractmethod
    def splat(self, planes: Tensor, view: PinholeView, twist: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Colour (3, H, W), depth (H, W), alpha (H, W), visible (N,) bool; ``twist`` (6,) perturbs the view (left)."""

    def render(self, planes: Tensor, view: PinholeView, differentiable: bool = True) -> Rendered:
        leaf = planes.detach().to(self.device, self.dtype).requires_grad_(differentiable)
        twist = torch.zeros(6, dtype=self.dtype, device=self.device, requires_grad=differentiable)
        with torch.set_grad_enabled(differentiable):
            color, depth, alpha, visible = self.splat(leaf, view, twist)
        context = (leaf, twist, color, depth, alpha, visible, planes.dtype) if differentiable else None
        images = [image.detach().to(planes.dtype) for image in (color, depth, alpha)]
        return Rendered(images[0], images[1], images[2], context)

    def backward(
        self,
        rendered: Rendered,
        grad_color: Tensor | None,
        grad_depth: Tensor | None,
        grad_alpha: Tensor | None,
        pose: bool = False,
        learning: int | None = None,
    ) -> Gradients:
        leaf, twist, *images, visible, dtype = rendered.context
        rendered.context = None
        pairs = [(i, g) for i, g in zip(images, (grad_color, grad_depth, grad_alpha), strict=True) if g is not None]
        by_planes, by_twist = torch.zeros_like(leaf), torch.zeros_like(twist)
        if pairs:
            by_planes, by_twist = torch.autograd.grad(
                [image for image, _ in pairs],
                [leaf, twist],
                [g.to(self.dtype) for _, g in pairs],
                allow_unused=True,
                materialize_grads=True,
            )
        by_learning = by_planes[:, :learning].to(dtype)
        return Gradients(by_learning, visible[:learning], by_twist.double() if pose else None)


def perturbed(T_cam_world: Tensor, twist: Tensor) -> tuple[Tensor, Tensor]:
    """Rotation (3, 3) and translation (3,) of (I + [twist]) T_cam_world: exact derivatives at twist = 0."""
    rho, theta = twist[:3], twist[3:]
    zero = torch.zeros_like(theta[0])
    cross = torch.stack(
        [
            torch.stack([zero, -theta[2], theta[1]]),
            torch.stack([theta[2], zero, -theta[0]]),
            torch.stack([-theta[1], theta[0], zero]),
        ]
    )
    turn = torch.eye(3, dtype=twist.dtype, device=twist.device) + cross
    return turn @ T_cam_world[:3, :3], turn @ T_cam_world[:3, 3] + rho
