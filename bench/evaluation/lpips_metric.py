"""LPIPS, the learned perceptual distance, with the ``lpips`` package and genuine AlexNet weights."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
import torch

from bench.errors import BenchError
from bench.evaluation.alexnet_weights import WeightsFound, find_alexnet_weights, load_alexnet_weights
from bench.types import Image

__all__ = ["Lpips", "WeightsFound", "find_alexnet_weights"]

MINIMUM_SIDE = 31
"""Smaller images have no pixel left after AlexNet's two poolings."""


class Lpips:
    """LPIPS v0.1 with net=alex on a GPU when there is one; build it once, it takes seconds to import.

    Raises ``BenchError`` when the weights file is damaged.
    Source: Zhang et al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", CVPR 2018.
    """

    def __init__(self, weights: WeightsFound) -> None:
        features = load_alexnet_weights(weights.path)
        package = _import_lpips()
        # The package first fills the network with random numbers: keep the global generator out of it.
        with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # torchvision's about the package's use of `pretrained`
            network = package.LPIPS(net="alex", pnet_rand=True, verbose=False)
        trunk = {
            name.rpartition("slice")[2].partition(".")[2]: tensor for name, tensor in network.net.named_parameters()
        }
        for key, tensor in trunk.items():
            tensor.data.copy_(features[key])
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        # Channels last: a fifth less time on a CPU, the same numbers to float32 rounding.
        self._network = network.eval().to(self._device, memory_format=torch.channels_last)

    def __call__(self, images: Sequence[Image], references: Sequence[Image]) -> list[float]:
        """One distance per pair; images are uint8 (H, W, 3), all of one size, at least 31 pixels per side.

        On a CPU pairs one by one are fastest, so a batch is for GPUs. Raises ``BenchError`` for too small images.
        """
        if min(images[0].shape[:2]) < MINIMUM_SIDE:
            height, width = images[0].shape[:2]
            raise BenchError(
                f"LPIPS needs images of at least {MINIMUM_SIDE}x{MINIMUM_SIDE} pixels; these are {width}x{height}."
            )
        with torch.inference_mode():
            distances = self._network(self._scaled(images), self._scaled(references))
            return [float(value) for value in distances.flatten().cpu()]

    def _scaled(self, images: Sequence[Image]) -> torch.Tensor:
        """(N, 3, H, W) float32 in [-1, 1]; uint8 input needs no clamping."""
        stacked = torch.from_numpy(np.stack(images)).to(self._device)
        # NHWC seen as NCHW is already channels last.
        return stacked.permute(0, 3, 1, 2).to(torch.float32).div_(127.5).sub_(1.0)


def _import_lpips() -> ModuleType:
    """Import ``lpips``, also beside a torch whose torchvision lacks its compiled operators.

    Where no torchvision is built for the installed torch, its import stops because it describes the operator
    ``torchvision::nms`` that is not there. LPIPS uses none of these operators; so the describing is switched off
    while importing, and only then, and only when importing fails.
    """
    try:
        return importlib.import_module("lpips")
    except RuntimeError as error:
        if "torchvision::" not in str(error):
            raise
    for name in [name for name in sys.modules if name.partition(".")[0] in ("torchvision", "lpips")]:
        del sys.modules[name]
    original = torch.library.register_fake
    torch.library.register_fake = _describe_nothing
    try:
        return importlib.import_module("lpips")
    finally:
        torch.library.register_fake = original


def _describe_nothing(*_: Any, **__: Any) -> Any:
    """Stands in for ``torch.library.register_fake``: a decorator that leaves the function as it is."""
    return lambda function: function
