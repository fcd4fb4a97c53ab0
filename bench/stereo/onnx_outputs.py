"""The disparity in what an ONNX stereo network gives: which output, which channel, of which size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.errors import BenchError
from bench.stereo.onnx_session import describe, find_tensor
from bench.types import Float, Map

# How exporters call the disparity among several outputs, the best name first.
_NAMES = ("disp", "flow_up", "flow")


def choose_output(outputs: Sequence[Any], wanted: str, path: Path) -> Any:
    """The disparity's output: the one that is ``wanted`` (name or position), else the one called so, else the first."""
    if wanted:
        return find_tensor(outputs, wanted, "output", path)
    for name in _NAMES:
        called = [tensor for tensor in outputs if name in tensor.name.lower()]
        if len(called) == 1:
            return called[0]
    return outputs[0]


def map_in(output: Float, tensor: Any, channel: int | None, fed: tuple[int, int], path: Path) -> Map:
    """One map (h, w) float32 of an output for images of size ``fed``: as large as they are, or the same part of both
    sides; of a flow's two channels the first unless ``channel`` says otherwise. Raises ``BenchError``."""
    maps = output.reshape(fed) if output.ndim == 1 and output.size == fed[0] * fed[1] else np.squeeze(output)
    where = f"{path}: {describe(tensor)} has the shape {output.shape} for images of {fed[0]} x {fed[1]}"
    if maps.ndim == 3:
        maps = np.moveaxis(maps, 0 if maps.shape[0] <= maps.shape[2] else 2, 0)
        if channel is None and len(maps) > 2:
            raise BenchError(
                f"{where}: {len(maps)} maps. Say which is the disparity: stereo.channel=0, or -1 (the last)."
            )
        if not -len(maps) <= (channel or 0) < len(maps):
            raise BenchError(f"{where}, and no channel {channel}; stereo.channel can be 0 to {len(maps) - 1}.")
        maps = maps[channel or 0]
    elif channel not in (None, 0, -1):
        raise BenchError(f"{where}: one map, and no channel {channel}. Leave stereo.channel out.")
    if maps.ndim == 2 and _is_part(maps.shape, fed):
        return maps.astype(np.float32)
    transposed = maps.ndim == 2 and _is_part(maps.shape[::-1], fed)
    raise BenchError(
        f"{where}; expected one number per pixel, of these images or of smaller ones of their shape. "
        + (
            "Height and width are exchanged: export it with the height first."
            if transposed
            else "Choose another stereo.output or stereo.confidence, if there is one."
        )
    )


def _is_part(shape: tuple[int, ...], fed: tuple[int, int]) -> bool:
    """Whether a map has the images' proportions, but for a pixel of its own that rounding takes or adds."""
    ratio = fed[1] / shape[1]
    return abs(shape[0] * ratio - fed[0]) <= (ratio if ratio > 1 else 1e-6)
