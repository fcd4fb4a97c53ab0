"""L1, L2 and SSIM of a render against its target, with the gradient: fused in the C++ core on the CPU, else torch."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch

from bench.supervision.ssim import ssim
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor


class Photometric(NamedTuple):
    """Weights, or values, of the mean absolute error, the mean squared error and 1 - mean SSIM."""

    l1: float = 0.0
    l2: float = 0.0
    dssim: float = 0.0

    def weighted(self, weights: Photometric) -> float:
        """Sum of the three, each times its weight."""
        return self.l1 * weights.l1 + self.l2 * weights.l2 + self.dssim * weights.dssim


def photometric(color: Tensor, target: Target, weights: Photometric) -> tuple[Photometric, Tensor]:
    """The values, and the gradient (3, H, W) of their weighted sum; the core says 0 for 1 - SSIM of weight 0."""
    if color.device.type == "cpu":
        import bench._native as _native

        grad = torch.empty_like(color)
        mean, variance = target.local_statistics
        l1, l2, similarity = _native.photometric(color, target.image, mean, variance, *weights, grad)
        return Photometric(l1, l2, 1.0 - similarity if weights.dssim else 0.0), grad
    leaf = color.detach().requires_grad_()
    with torch.enable_grad():
        error = leaf - target.image
        terms = (error.abs().mean(), error.square().mean(), 1.0 - ssim(leaf, target.image, target.local_statistics))
        (weights.l1 * terms[0] + weights.l2 * terms[1] + weights.dssim * terms[2]).backward()
    assert leaf.grad is not None
    return Photometric(*(float(term.detach()) for term in terms)), leaf.grad
