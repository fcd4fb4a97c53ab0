"""Forward warping: every pixel is spread over the four pixels around the place that it moves to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from torch import Tensor


def splat_sum(values: Tensor, flow: Tensor) -> Tensor:
    """Sum of ``values`` (B, C, H, W) moved by ``flow`` (B, 2, H, W; x and y in pixels), bilinear weights, (B, C, H, W).

    What leaves the image, or moves by a number that is not finite, is dropped. The same on the CPU and on CUDA, and
    without atomics where torch's deterministic algorithms are on. Source of the operation: Niklaus and Liu, "Softmax
    Splatting for Video Frame Interpolation", CVPR 2020, Eq. 2-4 (there "summation splatting").
    """
    batch, channels, height, width = values.shape
    columns = torch.arange(width, device=flow.device, dtype=flow.dtype)
    rows = torch.arange(height, device=flow.device, dtype=flow.dtype)[:, None]
    x, y = columns + flow[:, 0], rows + flow[:, 1]
    stays = torch.isfinite(x) & torch.isfinite(y)
    # One pixel outside is as good as far outside, and far outside does not fit an integer.
    x = torch.where(stays, x, -2.0).clamp(-2, width + 1)
    y = torch.where(stays, y, -2.0).clamp(-2, height + 1)
    x0, y0 = x.floor(), y.floor()
    # A frame of one or two pixels takes what falls outside, so that no index needs a test.
    wide, high = width + 5, height + 5
    out = values.new_zeros(batch, channels, high * wide)
    for right in (0, 1):
        for down in (0, 1):
            weight = (1 - (x - (x0 + right)).abs()) * (1 - (y - (y0 + down)).abs()) * stays
            place = (y0.long() + down + 2) * wide + x0.long() + right + 2
            for b in range(batch):
                out[b].index_add_(1, place[b].flatten(), (values[b] * weight[b]).flatten(1))
    return out.view(batch, channels, high, wide)[:, :, 2 : 2 + height, 2 : 2 + width]
