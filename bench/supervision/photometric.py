"""L1 and SSIM of a render against its target, with the gradient: fused in the C++ core on the CPU, torch elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bench.supervision.ssim import ssim
from bench.supervision.target import Target

if TYPE_CHECKING:
    from torch import Tensor


def photometric(color: Tensor, target: Target, weight_l1: float, weight_ssim: float) -> tuple[float, float, Tensor]:
    """Mean absolute error, mean SSIM, and the gradient (3, H, W) of weight_l1 * L1 + weight_ssim * (1 - SSIM)."""
    if color.device.type == "cpu":
        import bench._native as _native

        grad = torch.empty_like(color)
        mean, variance = target.local_statistics
        l1, similarity = _native.photometric(color, target.image, mean, variance, weight_l1, weight_ssim, grad)
        return l1, similarity, grad
    leaf = color.detach().requires_grad_()
    with torch.enable_grad():
        error = (leaf - target.image).abs().mean()
        structure = ssim(leaf, target.image, target.local_statistics)
        (weight_l1 * error + weight_ssim * (1.0 - structure)).backward()
    assert leaf.grad is not None
    return float(error), float(structure), leaf.grad
