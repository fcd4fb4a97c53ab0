"""Base class of stereo networks in torch: padding, normalisation, device and number format around one ``predict``."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
import torch

from bench.contracts.stereo import shape_hint
from bench.errors import BenchError
from bench.stereo.device import choose_device, choose_dtype
from bench.stereo.network import NetworkConfig, StereoNetwork
from bench.stereo.padding import next_multiple, pad_to
from bench.types import Image, Map


class TorchStereo(StereoNetwork):
    """A network in torch. An author writes ``load``, and where the network is not simply called, ``predict``::

        @dataclass(frozen=True)
        class MyNetConfig(NetworkConfig):
            iterations: int = 32

        @register("stereo", "my_net", config=MyNetConfig)
        class MyNet(TorchStereo):
            pad_multiple = 32

            def load(self) -> nn.Module:
                return MyModule(self.config.iterations)

    The class attributes say what the network expects: sides that are multiples of ``pad_multiple``, padded on
    ``pad_side`` ("top_right", "bottom_right", "centred"), and colours (x / 255 - ``mean``) / ``std`` in RGB. The
    defaults of the latter two are ImageNet's; mean 0 and std 1/255 leave colours 0 to 255.
    """

    pad_multiple: int = 32
    pad_side: str = "top_right"
    mean: tuple[float, float, float] = (0.485, 0.456, 0.406)
    std: tuple[float, float, float] = (0.229, 0.224, 0.225)

    def __init__(self, config: NetworkConfig, published: str = "") -> None:
        super().__init__(config, published)
        self.config: Any = config
        self.device = choose_device(config.device)
        self.dtype = choose_dtype(config.dtype)
        self.network = self.load().eval().requires_grad_(False).to(self.device)
        mean, std = (torch.tensor(three, dtype=torch.float32).view(1, 3, 1, 1) for three in (self.mean, self.std))
        self._gain = (1 / (255 * std)).to(self.device)
        self._offset = (-mean / std).to(self.device)

    @abstractmethod
    def load(self) -> torch.nn.Module:
        """The network with its weights (``self.weights_path``), on the CPU; the base class moves it to the device."""

    def predict(self, left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        """Disparity of the left image in pixels of these images: (H, W), also with one or two leading ones.

        ``left`` and ``right`` are (1, 3, H, W) float32 on ``self.device``, padded and normalised. Runs in inference
        mode, and under autocast where ``dtype`` is not float32.
        """
        disparity: torch.Tensor = self.network(left, right)
        return disparity

    def match(self, left: Image, right: Image) -> Map:
        """One pass of the network over a pair as it is fed; raises ``BenchError`` for a wrong shape."""
        shape = next_multiple((left.shape[0], left.shape[1]), self.pad_multiple)
        (padded_left, window), (padded_right, _) = (pad_to(image, shape, self.pad_side) for image in (left, right))
        reduced = self.dtype != torch.float32
        with (
            torch.inference_mode(),
            torch.autocast(self.device.type, self.dtype if reduced else None, enabled=reduced),
            torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True),
        ):
            output = self.predict(self._as_input(padded_left), self._as_input(padded_right))
            return self._as_map(output, shape)[window].copy()

    def _as_input(self, image: Image) -> torch.Tensor:
        """(H, W, 3) uint8 to (1, 3, H, W) float32, normalised, in channels-last memory."""
        pixels = torch.from_numpy(np.ascontiguousarray(image)).to(self.device)
        return pixels[None].permute(0, 3, 1, 2).float().mul_(self._gain).add_(self._offset)

    def _as_map(self, output: torch.Tensor, shape: tuple[int, int]) -> Map:
        what = f"{type(self).__name__}.predict"
        if not isinstance(output, torch.Tensor):
            raise BenchError(f"{what} returned {type(output).__name__}; return a tensor (1, 1, H, W) of disparities.")
        if tuple(output.shape[-2:]) != shape or output.numel() != shape[0] * shape[1]:
            hint = shape_hint(tuple(output.squeeze().shape), shape)
            raise BenchError(
                f"{what} returned a tensor of shape {tuple(output.shape)}; expected (1, 1, {shape[0]}, {shape[1]}), "
                f"one disparity per pixel of the padded image{hint and ': '}{hint}."
            )
        values: Map = output.reshape(shape).float().cpu().numpy()
        return values
