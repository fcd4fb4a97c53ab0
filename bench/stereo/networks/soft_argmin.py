"""Soft arg-min over a coarse cost volume, up-sampled on the way."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

# Rows at a time: the up-sampled volume of so many rows stays in a CPU's cache, and the whole one needs no memory.
_ROWS = 4


def upsampled_soft_argmin(score: Tensor, disparities: int, shape: tuple[int, int] | torch.Size) -> Tensor:
    """Expected disparity (1, 1, H, W) in px from scores (D, h, w), the larger the likelier (Kendall et al., ICCV 2017).

    The scores are up-sampled trilinearly to (``disparities``, H, W) with aligned corners, then a softmax weighs the
    disparities 0 .. ``disparities`` - 1.
    """
    levels = score.shape[0]
    fine = functional.interpolate(score[None], tuple(shape), mode="bilinear", align_corners=True)[0]
    to_disparities = _linear_interpolation(levels, disparities).to(fine)
    count = torch.arange(disparities, dtype=fine.dtype, device=fine.device)
    moments = torch.stack((torch.ones_like(count), count))
    rows = []
    for part in fine.split(_ROWS, dim=1):
        share = torch.mm(to_disparities, part.reshape(levels, -1))
        share = share.sub_(share.amax(0)).exp_()
        total, weighted = torch.mm(moments, share)
        rows.append((weighted / total).view(part.shape[1:]))
    return torch.cat(rows)[None, None]


def _linear_interpolation(levels: int, wanted: int) -> Tensor:
    """The matrix (wanted, levels) of linear interpolation with aligned ends."""
    return functional.interpolate(torch.eye(levels)[None], wanted, mode="linear", align_corners=True)[0].T
