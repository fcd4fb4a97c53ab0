"""LPIPS, the learned perceptual distance: genuine AlexNet weights, and the ``lpips`` package's linear layers."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from bench.errors import BenchError
from bench.evaluation.alexnet_weights import CONVOLUTIONS, WeightsFound, find_alexnet_weights, load_alexnet_weights
from bench.evaluation.winograd import WinogradConvolution
from bench.types import Image

__all__ = ["Lpips", "WeightsFound", "find_alexnet_weights"]

MINIMUM_SIDE = 31
"""Smaller images have no pixel left after AlexNet's two poolings."""
# Stride and padding of AlexNet's convolutions; before two of them comes a maximum over 3x3 pixels, every second one.
_STEPS = ((4, 2), (1, 2), (1, 1), (1, 1), (1, 1))
_POOLED = (1, 2)
# ImageNet's mean and deviation of RGB as LPIPS has them, for values in [-1, 1].
_MEAN, _DEVIATION = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


class Lpips:
    """LPIPS v0.1 with net=alex on a GPU when there is one.

    Raises ``BenchError`` when the weights file is damaged.
    Source: Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", CVPR 2018.
    """

    def __init__(self, weights: WeightsFound) -> None:
        features = load_alexnet_weights(weights.path)
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        # Channels last: a fifth less time on a CPU, the same numbers to float32 rounding.
        self._convolutions = [
            _convolution(
                features[f"{position}.weight"].to(self._device, memory_format=torch.channels_last),
                features[f"{position}.bias"].to(self._device),
                *steps,
            )
            for position, steps in zip(CONVOLUTIONS, _STEPS, strict=True)
        ]
        self._linear = [layer.to(self._device) for layer in _linear_layers()]
        self._mean, self._deviation = (
            torch.tensor(values, device=self._device).view(3, 1, 1) for values in (_MEAN, _DEVIATION)
        )

    def __call__(self, images: Sequence[Image], references: Sequence[Image]) -> list[float]:
        """One distance per pair; images are uint8 (H, W, 3), all of one size, at least 31 pixels per side.

        On a CPU pairs one by one are fastest, so several are for GPUs. Raises ``BenchError`` for too small images.
        """
        if min(images[0].shape[:2]) < MINIMUM_SIDE:
            height, width = images[0].shape[:2]
            raise BenchError(
                f"LPIPS needs images of at least {MINIMUM_SIDE}x{MINIMUM_SIDE} pixels; these are {width}x{height}."
            )
        with torch.inference_mode():
            values = self._scaled([*images, *references])
            total = torch.zeros(len(images), device=self._device)
            for index, (convolution, linear) in enumerate(zip(self._convolutions, self._linear, strict=True)):
                values = functional.max_pool2d(values, 3, 2) if index in _POOLED else values
                values = convolution(values).relu_()
                total += _distance(values, linear)
            return [float(value) for value in total.cpu()]

    def _scaled(self, images: Sequence[Image]) -> torch.Tensor:
        """(N, 3, H, W) float32 as the network wants it; uint8 input needs no clamping."""
        stacked = torch.from_numpy(np.stack(images)).to(self._device)
        # NHWC seen as NCHW is already channels last.
        values = stacked.permute(0, 3, 1, 2).to(torch.float32).div_(127.5).sub_(1.0)
        return values.sub_(self._mean).div_(self._deviation)


def _convolution(
    weight: torch.Tensor, bias: torch.Tensor, stride: int, padding: int
) -> Callable[[torch.Tensor], torch.Tensor]:
    """Those of 3x3 by Winograd's scheme on a CPU: at KITTI's size LPIPS takes a fifth less time."""
    if weight.shape[-1] == 3 and weight.device.type == "cpu":
        return WinogradConvolution(weight, bias)
    return lambda values: functional.conv2d(values, weight, bias, stride, padding)


def _distance(features: torch.Tensor, linear: torch.Tensor) -> torch.Tensor:
    """(N,) from features (2N, C, H, W) of N images and then of their references: of each pixel's features, scaled to
    length 1, the squared differences weighted by ``linear`` (C,); the mean over the pixels."""
    pixels = features.permute(0, 2, 3, 1).flatten(1, 2)
    # LPIPS adds 1e-10 to the length, so that features that are all 0 stay so.
    pixels = pixels / (torch.linalg.vector_norm(pixels, dim=2, keepdim=True) + 1e-10)
    images, references = pixels.chunk(2)
    return ((images - references).square_() @ linear).mean(1)


def _linear_layers() -> list[torch.Tensor]:
    """The five weights (C,) that LPIPS has trained; of the package only this file is read, since importing it imports
    torchvision and fills an AlexNet with random numbers."""
    path = Path(str(importlib.metadata.distribution("lpips").locate_file("lpips/weights/v0.1/alex.pth")))
    try:
        layers = torch.load(path, map_location="cpu", weights_only=True)
        return [layers[f"lin{index}.model.1.weight"].flatten() for index in range(len(CONVOLUTIONS))]
    except (OSError, KeyError, RuntimeError) as error:
        raise BenchError(
            f"{path} can't be read ({error}). Install again: pip install --force-reinstall lpips."
        ) from error
