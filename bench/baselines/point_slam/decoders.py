"""The two small networks that turn interpolated features into occupancy and colour."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch.nn import functional

from bench.baselines.point_slam.cloud import FEATURES

if TYPE_CHECKING:
    from torch import Generator, Tensor

_LAYERS, _SKIP_AFTER = 5, 2
_GEOMETRY_WIDTH, _GEOMETRY_SINES, _GEOMETRY_SCALE = 32, 93, 25.0
_COLOR_WIDTH, _COLOR_SINES, _COLOR_SCALE = 128, 20, 32.0
_RELATIVE_SINES, _RELATIVE_WIDTH = 10, 128
_SOFTPLUS_BETA = 100.0


def _linear(inputs: int, outputs: int, generator: Generator) -> torch.nn.Linear:
    """Weights by Glorot and Bengio (2010) from the generator, biases 0."""
    layer = torch.nn.utils.skip_init(torch.nn.Linear, inputs, outputs)
    torch.nn.init.xavier_uniform_(layer.weight, torch.nn.init.calculate_gain("relu"), generator=generator)
    torch.nn.init.zeros_(layer.bias)
    return layer


class FeatureMlp(torch.nn.Module):
    """Five layers; the feature enters each of them by a linear map, the input once more after the third."""

    def __init__(self, inputs: int, width: int, outputs: int, generator: Generator) -> None:
        super().__init__()
        widths = [inputs] + [width + (inputs if k == _SKIP_AFTER + 1 else 0) for k in range(1, _LAYERS)]
        self.pts_linears = torch.nn.ModuleList([_linear(each, width, generator) for each in widths])
        self.fc_c = torch.nn.ModuleList([_linear(FEATURES, width, generator) for _ in widths])
        self.output_linear = _linear(width, outputs, generator)

    def layers(self, encoded: Tensor, feature: Tensor, activation: Callable[[Tensor], Tensor]) -> Tensor:
        """Outputs (Q, outputs) of inputs (Q, inputs) and features (Q, 32)."""
        hidden = encoded
        for k, (layer, of_feature) in enumerate(zip(self.pts_linears, self.fc_c, strict=True)):
            hidden = activation(layer(hidden)) + of_feature(feature)
            if k == _SKIP_AFTER:
                hidden = torch.cat([encoded, hidden], 1)
        result: Tensor = self.output_linear(hidden)
        return result


class _Sines(torch.nn.Module):
    """Random Fourier features (Tancik et al., 2020) that are learned; under the name that the original's file has."""

    def __init__(self, generator: Generator) -> None:
        super().__init__()
        self._B = torch.nn.Parameter(_GEOMETRY_SCALE * torch.randn(3, _GEOMETRY_SINES, generator=generator))

    def forward(self, position: Tensor) -> Tensor:
        return torch.sin(position @ self._B)


class GeometryDecoder(FeatureMlp):
    """Occupancy logit of a place, from its position and the geometry feature there: 5 layers of 32, ReLU."""

    def __init__(self, generator: Generator) -> None:
        super().__init__(_GEOMETRY_SINES, _GEOMETRY_WIDTH, 1, generator)
        self.embedder = _Sines(generator)

    def forward(self, position: Tensor, feature: Tensor) -> Tensor:
        """Logits (Q,) at positions (Q, 3) with features (Q, 32)."""
        return self.layers(self.embedder(position), feature, functional.relu)[:, 0]


class ColorDecoder(FeatureMlp):
    """Colour of a place, from its position and the colour feature there: 5 layers of 128, softplus, then a sigmoid.

    With ``relative`` each neighbour's feature first passes a small network together with its relative position.
    """

    fourier: Tensor
    relative_fourier: Tensor

    def __init__(self, relative: bool, generator: Generator) -> None:
        super().__init__(2 * _COLOR_SINES, _COLOR_WIDTH, 3, generator)
        self.register_buffer("fourier", _COLOR_SCALE * torch.randn(3, _COLOR_SINES, generator=generator))
        self.relative = relative
        if relative:
            self.register_buffer(
                "relative_fourier", _COLOR_SCALE * torch.randn(3, _RELATIVE_SINES, generator=generator)
            )
            self.neighbour_in = _linear(FEATURES + 2 * _RELATIVE_SINES, _RELATIVE_WIDTH, generator)
            self.neighbour_out = _linear(_RELATIVE_WIDTH, FEATURES, generator)

    def of_neighbours(self, feature: Tensor, offset: Tensor) -> Tensor:
        """Features (N, 32) of neighbours, with their positions (N, 3) relative to the place, as they are averaged."""
        hidden = torch.cat([feature, _waves(offset, self.relative_fourier)], 1)
        result: Tensor = self.neighbour_out(functional.softplus(self.neighbour_in(hidden), _SOFTPLUS_BETA))
        return result

    def forward(self, position: Tensor, feature: Tensor) -> Tensor:
        """Colours (Q, 3) in [0, 1] at positions (Q, 3) with features (Q, 32)."""
        hidden = self.layers(
            _waves(position, self.fourier), feature, lambda values: functional.softplus(values, _SOFTPLUS_BETA)
        )
        return torch.sigmoid(hidden)


def _waves(position: Tensor, frequencies: Tensor) -> Tensor:
    phase = position @ frequencies
    return torch.cat([torch.sin(phase), torch.cos(phase)], 1)
