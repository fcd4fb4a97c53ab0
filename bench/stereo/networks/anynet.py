"""AnyNet (Wang et al., "Anytime Stereo Image Depth Estimation on Mobile Devices", ICRA 2019), without its last stage.

A U-Net gives features at 1/16, 1/8 and 1/4. The coarsest matches all disparities; each finer one corrects what was
found before by at most two of its pixels. Module names are the published checkpoints' keys; their SPN refinement
(``refine_spn``) is left out.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.stereo.networks.planes import PlaneAggregation

COARSE_DISPARITIES = 12
"""Disparities 0 .. 11 at 1/16 of the size, so up to 176 px at full size."""
CORRECTIONS = (-2, -1, 0, 1, 2)
"""Corrections of the finer stages, in their pixels."""
_CHANNELS_3D = (16, 4, 4)
_LAYERS_3D = 4


class AnyNet(nn.Module):
    """Left and right (1, 3, H, W), ImageNet-normalised, H and W multiples of 16, to disparity (1, 1, H, W) in px."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_extraction = _UNet()
        self.volume_postprocess = nn.ModuleList(_aggregation(channels) for channels in _CHANNELS_3D)

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Disparity of the third, finest stage."""
        features = zip(self.feature_extraction(left), self.feature_extraction(right), strict=True)
        height, width = left.shape[2:]
        disparity = left.new_zeros(1, 1, height, width)
        for stage, (of_left, of_right) in enumerate(features):
            ratio = height / of_left.shape[2]
            if stage == 0:
                cost = full_volume(of_left, of_right, COARSE_DISPARITIES)
                candidates = torch.arange(COARSE_DISPARITIES)
            else:
                coarse = _upsample(disparity, of_left.shape[2:]) / ratio
                cost = correction_volume(of_left, of_right, coarse)
                candidates = torch.tensor(CORRECTIONS)
            cost = self.aggregate(stage, cost)
            # Soft arg-min (Kendall et al., ICCV 2017).
            share = functional.softmax(-cost.float(), dim=1)
            found = (share * candidates.to(share).view(1, -1, 1, 1)).sum(1, keepdim=True) * ratio
            disparity = disparity + _upsample(found, (height, width))
        return disparity

    def aggregate(self, stage: int, cost: Tensor) -> Tensor:
        """Costs (1, D, h, w) from a stage's volume (1, D, h, w)."""
        aggregated: Tensor = self.volume_postprocess[stage](cost[:, None])[:, 0]
        return aggregated


class FastAnyNet(AnyNet):
    """The same network for inference: built from a trained one, whose 3D convolutions it runs as 2D ones."""

    def __init__(self, trained: AnyNet) -> None:
        super().__init__()
        planes = (COARSE_DISPARITIES, len(CORRECTIONS), len(CORRECTIONS))
        self.feature_extraction = trained.feature_extraction
        self.volume_postprocess = nn.ModuleList(
            PlaneAggregation(chain, count) for chain, count in zip(trained.volume_postprocess, planes, strict=True)
        )

    def aggregate(self, stage: int, cost: Tensor) -> Tensor:
        """Costs (1, D, h, w), with the planes as channels."""
        aggregated: Tensor = self.volume_postprocess[stage](cost)
        return aggregated


def full_volume(left: Tensor, right: Tensor, disparities: int) -> Tensor:
    """L1 distances (1, D, h, w) of features (1, C, h, w) at all disparities; the right ones are 0 outside the image."""
    padded = functional.pad(right, (disparities - 1, 0))
    width = left.shape[3]
    shifted = [padded[..., disparities - 1 - d : disparities - 1 - d + width] for d in range(disparities)]
    return torch.stack([(left - part).abs().sum(1) for part in shifted], dim=1)


def correction_volume(left: Tensor, right: Tensor, disparity: Tensor) -> Tensor:
    """L1 distances (1, 5, h, w) around a coarse ``disparity`` (1, 1, h, w), by bilinear sampling, 0 outside.

    Plane i samples at ``disparity - CORRECTIONS[i]``, though what comes of it is counted as + CORRECTIONS[i]: the
    published networks were trained so, and their 3D convolutions turn the order of the planes around.
    """
    height, width = left.shape[2:]
    columns = torch.arange(width, device=left.device, dtype=torch.float32)
    rows = torch.arange(height, device=left.device, dtype=torch.float32)
    y = (2 / (height - 1) * rows - 1).view(height, 1).expand(height, width)
    distances = []
    for correction in CORRECTIONS:
        x = (columns - disparity[0, 0] + correction) * (2 / (width - 1)) - 1
        sampled = functional.grid_sample(right, torch.stack((x, y), dim=-1)[None].to(right), align_corners=True)
        distances.append((left - sampled).abs().sum(1))
    return torch.stack(distances, dim=1)


class _UNet(nn.Module):
    """An image (1, 3, H, W) to features: 8 channels at 1/16, 4 at 1/8, 2 at 1/4."""

    def __init__(self) -> None:
        super().__init__()
        halve = nn.MaxPool2d(2)
        self.block0 = nn.Sequential(
            nn.Sequential(nn.Conv2d(3, 1, 3, padding=1), _conv2d(1, 1, stride=2)),
            nn.Sequential(halve, _conv2d(1, 2), _conv2d(2, 2)),
        )
        self.blocks = nn.ModuleList(nn.Sequential(halve, _conv2d(c, 2 * c), _conv2d(2 * c, 2 * c)) for c in (2, 4))
        self.upblocks = nn.ModuleList(_UpBlock(c) for c in (4, 2))

    def forward(self, image: Tensor) -> list[Tensor]:
        """Coarsest first."""
        quarter = self.block0(image)
        eighth = self.blocks[0](quarter)
        sixteenth = self.blocks[1](eighth)
        eighth = self.upblocks[0](eighth, sixteenth)
        return [sixteenth, eighth, self.upblocks[1](quarter, eighth)]


class _UpBlock(nn.Module):
    """Merges ``channels`` features with twice as many of half the size."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Sequential(_conv2d(3 * channels, channels), _conv2d(channels, channels))

    def forward(self, fine: Tensor, coarse: Tensor) -> Tensor:
        merged: Tensor = self.conv(torch.cat((fine, _upsample(coarse, fine.shape[2:])), dim=1))
        return merged


def _conv2d(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.BatchNorm2d(inputs), nn.ReLU(), nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
    )


def _conv3d(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.BatchNorm3d(inputs), nn.ReLU(), nn.Conv3d(inputs, outputs, 3, padding=1, bias=False))


def _aggregation(channels: int) -> nn.Sequential:
    """Cost (1, 1, D, h, w) to cost of the same shape."""
    inner = (_conv3d(channels, channels) for _ in range(_LAYERS_3D))
    return nn.Sequential(_conv3d(1, channels), *inner, _conv3d(channels, 1))


def _upsample(values: Tensor, shape: tuple[int, int] | torch.Size) -> Tensor:
    return functional.interpolate(values, tuple(shape), mode="bilinear", align_corners=False)
