"""Put batch normalisations into the convolutions before them: the same network, with less to do."""

from __future__ import annotations

from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval


def fold_batch_norms(network: nn.Module) -> None:
    """Change ``network`` (in evaluation mode) in place: each ``Sequential`` of convolution, batch normalisation, ...
    loses the normalisation."""
    for module in network.modules():
        if not isinstance(module, nn.Sequential):
            continue
        for i in range(len(module) - 1):
            convolution, norm = module[i], module[i + 1]
            if not isinstance(norm, nn.BatchNorm2d | nn.BatchNorm3d):
                continue
            if isinstance(convolution, nn.Conv2d | nn.Conv3d | nn.ConvTranspose3d):
                transposed = isinstance(convolution, nn.ConvTranspose3d)
                module[i] = fuse_conv_bn_eval(convolution, norm, transpose=transposed)
                module[i + 1] = nn.Identity()
