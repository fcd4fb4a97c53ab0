"""PSMNet (Chang and Chen, "Pyramid Stereo Matching Network", CVPR 2018) with the stacked hourglass, for inference.

Features at 1/4 with pooling over four sizes, a volume of both images' features over 48 disparities, three 3D
hourglasses, and a soft arg-min over 192 disparities. Module names are the published checkpoints' keys. Bilinear and
trilinear up-sampling align corners, as in the torch that the checkpoints were trained with.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.stereo.networks.concat_volume import volume_convolution
from bench.stereo.networks.single_output import SingleOutputConv3d
from bench.stereo.networks.soft_argmin import upsampled_soft_argmin

MAX_DISPARITY = 192
_POOLS = (64, 32, 16, 8)


class PsmNet(nn.Module):
    """Left and right (1, 3, H, W), ImageNet-normalised, H and W multiples of 16, to disparity (1, 1, H, W) in px."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_extraction = _Features()
        self.dres0 = nn.Sequential(_norm3d(64, 32), nn.ReLU(inplace=True), _norm3d(32, 32), nn.ReLU(inplace=True))
        self.dres1 = nn.Sequential(_norm3d(32, 32), nn.ReLU(inplace=True), _norm3d(32, 32))
        self.dres2, self.dres3, self.dres4 = _Hourglass(), _Hourglass(), _Hourglass()
        self.classif1, self.classif2, self.classif3 = _classifier(), _classifier(), _classifier()

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Disparity of the third hourglass, whose costs are the sum of all three."""
        of_left, of_right = self.feature_extraction(left), self.feature_extraction(right)
        convolution, norm = self.dres0.get_submodule("0.0"), self.dres0.get_submodule("0.1")
        assert isinstance(convolution, nn.Conv3d)
        values = volume_convolution(of_left, of_right, convolution.weight, convolution.bias, MAX_DISPARITY // 4)
        values = self.dres0[1:](norm(values))
        values = self.dres1(values).add_(values)

        result, inner, after = values, None, None
        cost = torch.zeros((), device=left.device)
        hourglasses = ((self.dres2, self.classif1), (self.dres3, self.classif2), (self.dres4, self.classif3))
        for hourglass, classifier in hourglasses:
            result, down, after = hourglass(result, inner, after)
            # What an hourglass adds after its bottom is always the first one's.
            inner = down if inner is None else inner
            result += values
            cost = cost + classifier(result)
        return upsampled_soft_argmin(cost[0, 0].float(), MAX_DISPARITY, left.shape[2:])


class _Features(nn.Module):
    """An image (1, 3, H, W) to 32 features at a quarter of its size."""

    def __init__(self) -> None:
        super().__init__()
        self.firstconv = nn.Sequential(
            _norm2d(3, 32, stride=2),
            nn.ReLU(inplace=True),
            _norm2d(32, 32),
            nn.ReLU(inplace=True),
            _norm2d(32, 32),
            nn.ReLU(inplace=True),
        )
        self.layer1 = _residuals(3, 32, 32)
        self.layer2 = _residuals(16, 32, 64, stride=2)
        self.layer3 = _residuals(3, 64, 128)
        self.layer4 = _residuals(3, 128, 128, dilation=2)
        for number, size in enumerate(_POOLS, start=1):
            self.add_module(f"branch{number}", _PooledBranch(size))
        self.lastconv = nn.Sequential(_norm2d(320, 128), nn.ReLU(inplace=True), nn.Conv2d(128, 32, 1, bias=False))

    def forward(self, image: Tensor) -> Tensor:
        quarter = self.layer2(self.layer1(self.firstconv(image)))
        deep = self.layer4(self.layer3(quarter))
        pooled = [self.get_submodule(f"branch{number}")(deep) for number in (4, 3, 2, 1)]
        features: Tensor = self.lastconv(torch.cat((quarter, deep, *pooled), dim=1))
        return features


class _PooledBranch(nn.Sequential):
    """Means over squares of ``size``, mixed, and brought back to the size they came from.

    A map that is smaller than the square is pooled over its whole height or width, so that small images work too.
    """

    def __init__(self, size: int) -> None:
        super().__init__(nn.Identity(), _norm2d(128, 32, kernel=1), nn.ReLU(inplace=True))
        self._size = size

    def forward(self, features: Tensor) -> Tensor:
        shape = features.shape[2:]
        pooled = functional.avg_pool2d(features, [min(self._size, side) for side in shape])
        mixed: Tensor = super().forward(pooled)
        return functional.interpolate(mixed, shape, mode="bilinear", align_corners=True)


class _Residual(nn.Module):
    """Two convolutions and a shortcut, without a ReLU after the sum."""

    def __init__(self, inputs: int, outputs: int, stride: int, dilation: int) -> None:
        super().__init__()
        self.conv1 = nn.Sequential(_norm2d(inputs, outputs, stride=stride, dilation=dilation), nn.ReLU(inplace=True))
        self.conv2 = _norm2d(outputs, outputs, dilation=dilation)
        changes = stride != 1 or inputs != outputs
        self.downsample = _norm2d(inputs, outputs, kernel=1, stride=stride) if changes else nn.Identity()

    def forward(self, values: Tensor) -> Tensor:
        added: Tensor = self.conv2(self.conv1(values)).add_(self.downsample(values))
        return added


class _Hourglass(nn.Module):
    """Down to a quarter of the volume's sides and up again, with shortcuts inside and from the hourglass before."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Sequential(_norm3d(32, 64, stride=2), nn.ReLU(inplace=True))
        self.conv2 = _norm3d(64, 64)
        self.conv3 = nn.Sequential(_norm3d(64, 64, stride=2), nn.ReLU(inplace=True))
        self.conv4 = nn.Sequential(_norm3d(64, 64), nn.ReLU(inplace=True))
        self.conv5 = _transposed3d(64, 64)
        self.conv6 = _transposed3d(64, 32)

    def forward(self, values: Tensor, before: Tensor | None, after: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Result at full size, and the half-size values before and after the bottom; the latter two of an earlier
        hourglass come back in: ``before`` is added after the bottom, ``after`` before it."""
        down = self.conv2(self.conv1(values))
        down = functional.relu_(down if after is None else down.add_(after))
        up = self.conv5(self.conv4(self.conv3(down)))
        up = functional.relu_(up.add_(down if before is None else before))
        return self.conv6(up), down, up


def _norm2d(inputs: int, outputs: int, kernel: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    padding = dilation * (kernel // 2)
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, padding, dilation, bias=False), nn.BatchNorm2d(outputs)
    )


def _norm3d(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv3d(inputs, outputs, 3, stride, padding=1, bias=False), nn.BatchNorm3d(outputs))


def _transposed3d(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.ConvTranspose3d(inputs, outputs, 3, stride=2, padding=1, output_padding=1, bias=False),
        nn.BatchNorm3d(outputs),
    )


def _classifier() -> nn.Sequential:
    return nn.Sequential(_norm3d(32, 32), nn.ReLU(inplace=True), SingleOutputConv3d(32))


def _residuals(count: int, inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    first = _Residual(inputs, outputs, stride, dilation)
    return nn.Sequential(first, *(_Residual(outputs, outputs, 1, dilation) for _ in range(count - 1)))
