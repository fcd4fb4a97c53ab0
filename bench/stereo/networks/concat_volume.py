"""The first 3D convolution over a volume of concatenated features, without ever building the volume.

The volume holds at disparity d and column x the left features of x above the right ones of x - d, both zero where
x - d < 0. So the left half depends on x alone and the right half on u = x - d alone, but for which taps of the kernel
fall into the zeros: those depend on t = x - d where -2 <= t <= 1, on whether d is the first or the last disparity, and
on whether x is the last column. The convolution is then a few 2D ones and a sum of shifted slices. PSMNet's takes a
sixth of the network's arithmetic, and the volume 360 MB of a KITTI frame.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

# Offsets t = x - d with taps of their own; from the last one on no tap falls into the zeros at the left.
_OFFSETS = (-2, -1, 0, 1, 2)


def volume_convolution(left: Tensor, right: Tensor, weight: Tensor, bias: Tensor | None, disparities: int) -> Tensor:
    """``conv3d(volume, weight, bias, padding=1)`` for features (1, C, h, w) and a kernel (Co, 2 C, 3, 3, 3).

    Returns (1, Co, D, h, w) in channels-last memory, D = ``disparities`` >= 2.
    """
    channels, width = left.shape[1], left.shape[3]
    of_left = _left_part(left, weight[:, :channels])
    of_right, beyond = _right_part(right, weight[:, channels:])
    volume = of_left.new_zeros((disparities, *left.shape[2:], weight.shape[0])).permute(0, 3, 1, 2)
    if bias is not None:
        volume += bias.view(1, -1, 1, 1)
    for d in range(min(disparities, width + 2)):
        case = 1 if d == 0 else 2 if d == disparities - 1 else 0
        plane, first = volume[d], max(0, d - 2)
        # Column x of the plane sees u = x - d, which is column u + 2 of what the right image gives.
        plane[..., first:] += of_right[case, ..., first - d + 2 : width - d + 2]
        plane[..., -1] -= beyond[case, ..., width - 1 - d + 2]
        plane[..., d + 2 :] += of_left[case, -1, ..., d + 2 :]
        for number, t in enumerate(_OFFSETS[:-1]):
            if 0 <= d + t < width:
                plane[..., d + t] += of_left[case, number, ..., d + t]
    return volume.permute(1, 0, 2, 3)[None]


def _kept_planes(like: Tensor) -> Tensor:
    """(3, 3): which of the kernel's three planes lie in the volume, for inner disparities, the first and the last."""
    return torch.tensor([[1, 1, 1], [0, 1, 1], [1, 1, 0]], dtype=like.dtype, device=like.device)


def _left_part(left: Tensor, weight: Tensor) -> Tensor:
    """Convolutions of the left features: (3 cases of planes, 5 offsets t, Co, h, w)."""
    tap = torch.arange(3, device=left.device)
    offset = torch.tensor(_OFFSETS, device=left.device)
    # At offset t the tap (plane k, column x) reads the volume at x - d = t + x - k.
    seen = (offset[:, None, None] + tap[None, None, :] - tap[None, :, None] >= 0).to(weight)
    kernels = torch.einsum("oikyx,ck,tkx->ctoiyx", weight, _kept_planes(weight), seen)
    values = functional.conv2d(left, kernels.flatten(0, 2), padding=1)
    return values.view(3, len(_OFFSETS), weight.shape[0], *left.shape[2:])


def _right_part(right: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Convolutions of the right features at u = -2 .. w - 1, and the share of the taps right of column x: twice
    (3 cases of planes, Co, h, w + 2). In the volume's last column that share has to go, as it lies outside."""
    tap = torch.arange(3, device=right.device)
    # The tap (plane k, column x) reads the right image at u + x - k, from two columns left of u to two right of it.
    place = functional.one_hot(tap[None, :] - tap[:, None] + 2, 5).to(weight)
    kept = _kept_planes(weight)
    kernels = torch.einsum("oikyx,ck,kxj->coiyj", weight, kept, place)
    last = torch.einsum("oiky,ck,kj->coiyj", weight[..., 2], kept, place[:, 2])
    padded = functional.pad(right, (4, 2, 1, 1))
    values = functional.conv2d(padded, torch.stack((kernels, last)).flatten(0, 2))
    both = values.view(2, 3, weight.shape[0], *values.shape[2:])
    return both[0], both[1]
