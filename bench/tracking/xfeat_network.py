"""XFeat (Potje et al., "XFeat: Accelerated Features for Lightweight Image Matching", CVPR 2024), for inference.

A slim backbone gives, at 1/8 of the image, descriptors and how reliable they are; keypoints come from 8x8 blocks of the
image itself. Module names are the published checkpoint's keys. The layers that match coarse features (``fine_matcher``)
are left out: the tracker matches around places that it predicts.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

CELL = 8
"""Side in pixels of the blocks that keypoints are looked for in, and of the descriptors' grid."""
MULTIPLE = 32
"""Sides of an image must be multiples of this."""
CHANNELS = 64
"""Values of a descriptor."""


class XFeat(nn.Module):
    """Grey images (B, 1, H, W) of zero mean and unit variance, H and W multiples of 32, to three maps: descriptors
    (B, 64, H/8, W/8), not normalised; keypoint logits (B, 65, H/8, W/8), 64 pixels of each block row by row and "none";
    reliability (B, 1, H/8, W/8) in 0..1."""

    def __init__(self) -> None:
        super().__init__()
        self.skip1 = nn.Sequential(nn.AvgPool2d(4), nn.Conv2d(1, 24, 1))
        self.block1 = nn.Sequential(_Layer(1, 4), _Layer(4, 8, stride=2), _Layer(8, 8), _Layer(8, 24, stride=2))
        self.block2 = nn.Sequential(_Layer(24, 24), _Layer(24, 24))
        self.block3 = nn.Sequential(_Layer(24, 64, stride=2), _Layer(64, 64), _Layer(64, 64, kernel=1))
        self.block4 = nn.Sequential(_Layer(64, 64, stride=2), _Layer(64, 64), _Layer(64, 64))
        self.block5 = nn.Sequential(
            _Layer(64, 128, stride=2), _Layer(128, 128), _Layer(128, 128), _Layer(128, 64, kernel=1)
        )
        self.block_fusion = nn.Sequential(_Layer(64, 64), _Layer(64, 64), nn.Conv2d(64, CHANNELS, 1))
        self.heatmap_head = nn.Sequential(
            _Layer(64, 64, kernel=1), _Layer(64, 64, kernel=1), nn.Conv2d(64, 1, 1), nn.Sigmoid()
        )
        self.keypoint_head = nn.Sequential(
            *(_Layer(64, 64, kernel=1) for _ in range(3)), nn.Conv2d(64, CELL * CELL + 1, 1)
        )

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Descriptors, keypoint logits and reliability (Sec. 3 of the paper)."""
        quarter = self.block2(self.block1(image) + self.skip1(image))
        eighth = self.block3(quarter)
        sixteenth = self.block4(eighth)
        below = (sixteenth, self.block5(sixteenth))
        size = eighth.shape[2:]
        descriptors = self.block_fusion(
            eighth + sum(functional.interpolate(coarse, size, mode="bilinear") for coarse in below)
        )
        logits = self.keypoint_head(functional.pixel_unshuffle(image, CELL))
        return descriptors, logits, self.heatmap_head(descriptors)


class _Layer(nn.Module):
    """Convolution, batch normalisation without gain and offset, ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> None:
        super().__init__()
        self.layer = nn.Sequential(
            nn.Conv2d(inputs, outputs, kernel, stride, padding=kernel // 2, bias=False),
            nn.BatchNorm2d(outputs, affine=False),
            nn.ReLU(inplace=True),
        )

    def forward(self, values: Tensor) -> Tensor:
        result: Tensor = self.layer(values)
        return result


def pixel_scores(logits: Tensor) -> Tensor:
    """Keypoint logits (B, 65, h, w) to the probability (B, 1, 8h, 8w) that a pixel is the keypoint of its block."""
    return functional.pixel_shuffle(torch.softmax(logits, dim=1)[:, :-1], CELL)
