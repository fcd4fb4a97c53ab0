"""SSIM as 3DGS trains with it: 11x11 Gaussian window, sigma 1.5, zero padding, mean over all pixels and channels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from torch import Tensor

_C1, _C2 = 0.01**2, 0.03**2


def gaussian_blur(image: Tensor) -> Tensor:
    """11x11 Gaussian, sigma 1.5, zero padding, of a (C, H, W) image: SSIM's window as in 3DGS."""
    k = torch.arange(-5, 6, device=image.device, dtype=image.dtype)
    taps = torch.exp(-k * k / (2 * 1.5**2))
    taps = taps / taps.sum()
    planes = image[:, None]
    planes = torch.nn.functional.conv2d(planes, taps.view(1, 1, 1, -1), padding=(0, 5))
    return torch.nn.functional.conv2d(planes, taps.view(1, 1, -1, 1), padding=(5, 0))[:, 0]


def local_statistics(image: Tensor) -> tuple[Tensor, Tensor]:
    """Local mean and variance (C, H, W) under SSIM's window."""
    if image.device.type == "cpu":
        import bench._native as _native

        mean, variance = torch.empty_like(image), torch.empty_like(image)
        _native.target_statistics(image, mean, variance)
        return mean, variance
    mean = gaussian_blur(image)
    return mean, gaussian_blur(image * image) - mean * mean


def ssim(image: Tensor, target: Tensor, statistics: tuple[Tensor, Tensor]) -> Tensor:
    """Mean SSIM of (C, H, W) images in [0, 1], zero-padded window (the form that 3DGS trains with); differentiable."""
    my, vy = statistics
    mx = gaussian_blur(image)
    vx = gaussian_blur(image * image) - mx * mx
    cov = gaussian_blur(image * target) - mx * my
    value = (2 * mx * my + _C1) * (2 * cov + _C2) / ((mx * mx + my * my + _C1) * (vx + vy + _C2))
    return value.mean()
