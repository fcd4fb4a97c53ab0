"""3D convolutions over few channels and few disparities, as 2D convolutions that have the planes as channels.

Libraries are built for many channels: with 4 channels and 5 disparities, torch's 3D convolution on a CPU takes ten
times as long as the 2D one with 20 channels, though that also multiplies by the zeros of its banded weights.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


class PlaneAggregation(nn.Module):
    """A chain of (BatchNorm3d, ReLU, Conv3d without bias) blocks for volumes with a fixed number of disparities.

    Takes the volume (1, D, h, w) to (1, D, h, w), the same as the chain's (1, 1, D, h, w) in evaluation mode. The
    kernels are 3 x 3 x 3 with padding 1; the chain begins and ends with one channel.
    """

    gain: Tensor
    offset: Tensor

    def __init__(self, chain: nn.Module, planes: int) -> None:
        super().__init__()
        norms = [module for module in chain.modules() if isinstance(module, nn.BatchNorm3d)]
        convolutions = [module for module in chain.modules() if isinstance(module, nn.Conv3d)]
        gain, offset = batch_norm_affine(norms[0])
        self.register_buffer("gain", gain)
        self.register_buffer("offset", offset)
        # Each further normalisation follows a convolution directly, so it goes into that one's weights.
        affines = [batch_norm_affine(norm) for norm in norms[1:]]
        self.convolutions = nn.ModuleList(
            _convolution(
                banded_weight(conv.weight * gain.view(-1, 1, 1, 1, 1), planes), offset.repeat_interleave(planes)
            )
            for conv, (gain, offset) in zip(convolutions[:-1], affines, strict=True)
        )
        self.convolutions.append(_convolution(banded_weight(convolutions[-1].weight, planes), None))

    def forward(self, volume: Tensor) -> Tensor:
        """Costs (1, D, h, w) to costs of the same shape."""
        values = volume * self.gain + self.offset
        for convolution in self.convolutions:
            values = convolution(functional.relu_(values))
        return values


def banded_weight(weight: Tensor, planes: int) -> Tensor:
    """Kernels (Co, Ci, 3, 3, 3) of a 3D convolution to (Co * D, Ci * D, 3, 3) of the 2D one over ``planes`` = D planes.

    Channel c of plane d becomes channel c * D + d.
    """
    outputs, inputs = weight.shape[:2]
    # bands[k, p, q] = 1 where plane p of the output sees plane q of the input through tap k of the kernel.
    bands = torch.stack([torch.diag(torch.ones(planes - abs(k)), k) for k in (-1, 0, 1)]).to(weight)
    return torch.einsum("oikyx,kpq->opiqyx", weight, bands).reshape(outputs * planes, inputs * planes, 3, 3)


def batch_norm_affine(norm: nn.BatchNorm3d) -> tuple[Tensor, Tensor]:
    """Gain and offset (C,) by which a batch normalisation acts in evaluation mode."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return gain.detach(), (norm.bias - norm.running_mean * gain).detach()


def _convolution(weight: Tensor, bias: Tensor | None) -> nn.Conv2d:
    convolution = nn.Conv2d(weight.shape[1], weight.shape[0], 3, padding=1, bias=bias is not None)
    convolution.weight = nn.Parameter(weight.detach().contiguous(memory_format=torch.channels_last))
    if bias is not None:
        convolution.bias = nn.Parameter(bias)
    return convolution
