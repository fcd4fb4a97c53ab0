"""Writes small ONNX files by hand, so that tests need no exporter: a protocol buffer is tags, lengths and bytes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

_FLOAT, _INTS = 1, 7


def _varint(value: int) -> bytes:
    parts = []
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _block(field: int, content: bytes | str) -> bytes:
    data = content.encode() if isinstance(content, str) else content
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _value(name: str, shape: Sequence[int | str]) -> bytes:
    dims = b"".join(_block(1, _number(1, d) if isinstance(d, int) else _block(2, d)) for d in shape)
    return _block(1, name) + _block(2, _block(1, _number(1, _FLOAT) + _block(2, dims)))


def _tensor(name: str, values: np.ndarray) -> bytes:
    dims = b"".join(_number(1, d) for d in values.shape)
    return dims + _number(2, _FLOAT) + _block(8, name) + _block(9, values.astype("<f4").tobytes())


def _ints(name: str, values: Sequence[int]) -> bytes:
    return _block(1, name) + b"".join(_number(8, v) for v in values) + _number(20, _INTS)


def write_classifier(
    path: Path,
    kernel: np.ndarray,
    stride: int,
    size: tuple[int | str, int | str] = ("h", "w"),
    inputs: Sequence[str] = ("pixel_values",),
    output: str = "logits",
) -> Path:
    """A network that is one 1x1 convolution with (C, 3) weights, taking every ``stride``-th pixel: [1, C, h/s, w/s].

    It reads the first of ``inputs``, each [1, 3, *size]; the others are only declared.
    """
    weight = np.asarray(kernel, np.float32)[:, :, None, None]
    node = b"".join(_block(1, name) for name in (inputs[0], "weight")) + _block(2, output) + _block(4, "Conv")
    node += _block(5, _ints("strides", [stride, stride])) + _block(5, _ints("kernel_shape", [1, 1]))
    graph = _block(1, node) + _block(2, "small") + _block(5, _tensor("weight", weight))
    graph += b"".join(_block(11, _value(name, (1, 3, *size))) for name in inputs)
    graph += _block(12, _value(output, (1, len(weight), "oh", "ow")))
    path.write_bytes(_number(1, 8) + _block(7, graph) + _block(8, _block(1, "") + _number(2, 13)))
    return path
