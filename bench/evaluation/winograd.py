"""3x3 convolutions with a quarter of the multiplications: Winograd's minimal filtering of tiles of 4x4 outputs."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn import functional

# F(4x4, 3x3) of Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", CVPR 2016.
_INPUT = np.array(
    [[4, 0, -5, 0, 1, 0], [0, -4, -4, 1, 1, 0], [0, 4, -4, -1, 1, 0], [0, -2, -1, 2, 1, 0], [0, 2, -1, -2, 1, 0],
     [0, 4, 0, -5, 0, 1]]
)  # fmt: skip
_FILTER = np.array([[6, 0, 0], [-4, -4, -4], [-4, 4, -4], [1, 2, 4], [1, -2, 4], [0, 0, 24]]) / 24
_OUTPUT = np.array([[1, 1, 1, 1, 1, 0], [0, 1, -1, 2, -2, 0], [0, 1, 1, 4, 4, 0], [0, 1, -1, 8, -8, 1]])
_TILE, _SIDE = _OUTPUT.shape


class WinogradConvolution:
    """``conv2d(values, weight, bias, padding=1)`` for a weight (O, C, 3, 3) on the CPU, rounded by up to about 5e-6 of
    the largest value."""

    def __init__(self, weight: torch.Tensor, bias: torch.Tensor) -> None:
        # Of both axes at once: rows times columns of a tile are one axis of 36 (16) values.
        self._input, self._output = (
            torch.from_numpy(np.kron(matrix, matrix)).to(torch.float32) for matrix in (_INPUT, _OUTPUT)
        )
        filters = np.einsum("ai,bj,ocij->abco", _FILTER, _FILTER, weight.double().numpy())
        self._filters = torch.from_numpy(filters.reshape(_SIDE**2, *filters.shape[2:])).to(torch.float32)
        self._bias = bias

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """(N, O, H, W) of values (N, C, H, W), both channels last."""
        count, channels, height, width = values.shape
        rows, columns = -(-height // _TILE), -(-width // _TILE)
        # Channels, then columns, then rows: a pixel beyond each border, and as many as fill the last tiles.
        beyond = (0, 0, 1, columns * _TILE - width + 1, 1, rows * _TILE - height + 1)
        padded = functional.pad(values.permute(0, 2, 3, 1), beyond).contiguous()
        image, row, column, channel = padded.stride()
        shape = (_SIDE, _SIDE, count, rows, columns, channels)
        tiles = padded.as_strided(shape, (row, column, image, row * _TILE, column * _TILE, channel))
        transformed = (self._input @ tiles.reshape(_SIDE**2, -1)).view(_SIDE**2, -1, channels)
        products = torch.bmm(transformed, self._filters).flatten(1)
        outputs = (self._output @ products).view(_TILE, _TILE, count, rows, columns, -1).permute(2, 3, 0, 4, 1, 5)
        whole = outputs.reshape(count, rows * _TILE, columns * _TILE, -1)
        return (whole[:, :height, :width] + self._bias).permute(0, 3, 1, 2)
