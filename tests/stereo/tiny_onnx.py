"""Small ONNX files, written byte by byte (protocol buffers), so that tests need no exporter.

``Graph`` collects nodes; ``block_matcher`` makes a stereo network of them that really matches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

FLOAT, UINT8, INT8, INT64 = 1, 2, 3, 7
_INT, _INTS = 2, 7
Shape = Sequence[int | str]


def _varint(value: int) -> bytes:
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _field(number: int, value: int | str | bytes) -> bytes:
    """One field of a message: an integer, or a text or message with its length."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _attribute(name: str, value: int | Sequence[int]) -> bytes:
    if isinstance(value, int):
        return _field(1, name) + _field(3, value) + _field(20, _INT)
    return _field(1, name) + b"".join(_field(8, item) for item in value) + _field(20, _INTS)


def _value(name: str, shape: Shape, element_type: int = FLOAT) -> bytes:
    sides = b"".join(_field(1, _field(1, side) if isinstance(side, int) else _field(2, side)) for side in shape)
    return _field(1, name) + _field(2, _field(1, _field(1, element_type) + _field(2, sides)))


@dataclass
class Graph:
    """Nodes and constants of a graph; ``save`` writes the file."""

    nodes: list[bytes] = field(default_factory=list)
    constants: list[bytes] = field(default_factory=list)

    def node(self, kind: str, *inputs: str, name: str = "", **attributes: int | Sequence[int]) -> str:
        """Append a node with one output, whose name is returned."""
        output = name or f"{kind}_{len(self.nodes)}"
        message = b"".join(_field(1, given) for given in inputs) + _field(2, output) + _field(4, kind)
        self.nodes.append(message + b"".join(_field(5, _attribute(key, value)) for key, value in attributes.items()))
        return output

    def constant(self, values: npt.ArrayLike, dtype: type) -> str:
        """Add a float32 or int64 constant, whose name is returned."""
        array: npt.NDArray[Any] = np.asarray(values, dtype)
        name = f"constant_{len(self.constants)}"
        kind = INT64 if dtype is np.int64 else FLOAT
        dims = b"".join(_field(1, side) for side in array.shape)
        self.constants.append(dims + _field(2, kind) + _field(8, name) + _field(9, array.tobytes()))
        return name

    def save(self, path: Path, inputs: dict[str, Shape], outputs: dict[str, Shape], element_type: int = FLOAT) -> Path:
        """Write an ONNX file of operator set 13, whose inputs are of ``element_type``."""
        graph = b"".join(_field(1, node) for node in self.nodes) + _field(2, "tiny")
        graph += b"".join(_field(5, constant) for constant in self.constants)
        graph += b"".join(_field(11, _value(name, shape, element_type)) for name, shape in inputs.items())
        graph += b"".join(_field(12, _value(name, shape)) for name, shape in outputs.items())
        path.write_bytes(_field(1, 8) + _field(7, graph) + _field(8, _field(1, "") + _field(2, 13)))
        return path


def block_matcher(
    path: Path,
    *,
    size: tuple[int | str, int | str] = ("h", "w"),
    names: tuple[str, str, str] = ("left", "right", "disp"),
    layout: str = "nchw",
    stacked: str = "",
    gain: float = 1.0,
    squeezed: bool = False,
    disparities: int = 24,
    colours: int = 3,
    element_type: int = FLOAT,
    flow: bool = False,
    half: tuple[str, str] = ("", ""),
    shrink: int = 1,
    right_first: bool = False,
) -> Path:
    """Least sum of absolute differences over 7 x 7 pixels: disparity times ``gain`` of images of ``size``.

    One input that is ``stacked`` takes the first name. ``squeezed`` leaves the channel out of the output. An image has
    ``colours`` channels of ``element_type``. A ``flow`` has a second channel, 500 everywhere. Two more inputs,
    ``half``, must be of half the size. The output is ``shrink`` times smaller, in its own pixels. The file may name the
    right input first.
    """
    graph = Graph()
    left, right = names[:2]
    batch, channels = (2, colours) if stacked == "batch" else (1, 2 * colours if stacked == "channels" else colours)
    if element_type != FLOAT:
        left, right = (graph.node("Cast", name, to=FLOAT) for name in (left, right))
    if stacked:
        axis, step = (0, 1) if stacked == "batch" else (1, colours)
        left, right = (_sliced(graph, names[0], axis, i * step, (i + 1) * step) for i in range(2))
    elif layout == "nhwc":
        left, right = (graph.node("Transpose", name, perm=(0, 3, 1, 2)) for name in (left, right))
    costs = []
    for d in range(disparities):
        # Padding by d on the left and -d on the right shifts the image.
        shifted = graph.node("Pad", right, graph.constant((0, 0, 0, d, 0, 0, 0, -d), np.int64))
        difference = graph.node("Abs", graph.node("Sub", left, shifted))
        mean = graph.node("ReduceMean", difference, axes=(1,), keepdims=1)
        costs.append(graph.node("AveragePool", mean, kernel_shape=(7, 7), pads=(3, 3, 3, 3)))
    best = graph.node("ArgMin", graph.node("Concat", *costs, axis=1), axis=1, keepdims=int(not squeezed))
    disparity = graph.node("Cast", best, to=FLOAT)
    for name in half if all(half) else ():
        # Twice as large it has to be of the size of the others, or adding fails.
        mean = graph.node("ReduceMean", name, axes=(1,), keepdims=1)
        scales = graph.constant((1, 1, 2, 2), np.float32)
        nothing = graph.node("Mul", graph.node("Resize", mean, "", scales), graph.constant(0.0, np.float32))
        disparity = graph.node("Add", disparity, nothing)
    if shrink > 1:
        small = graph.node("AveragePool", disparity, kernel_shape=(shrink, shrink), strides=(shrink, shrink))
        disparity = graph.node("Mul", small, graph.constant(1 / shrink, np.float32))
    if flow:
        other = graph.node(
            "Add", graph.node("Mul", disparity, graph.constant(0.0, np.float32)), graph.constant(500, np.float32)
        )
        disparity = graph.node("Concat", disparity, other, axis=1)
    if layout == "nhwc":
        disparity = graph.node("Transpose", disparity, perm=(0, 2, 3, 1))
    graph.node("Mul", disparity, graph.constant(gain, np.float32), name=names[2])
    inside: Shape = (batch, *size, channels) if layout == "nhwc" else (batch, channels, *size)
    outside: Shape = (1, *size) if squeezed else (1, *size, 1) if layout == "nhwc" else (1, 1, *size)
    if shrink > 1 or flow:
        outside = (1, 2 if flow else 1, "a", "b")
    inputs = {names[0]: inside} if stacked else {names[0]: inside, names[1]: inside}
    halves: Shape = (1, colours, *(side // 2 if isinstance(side, int) else f"half_{side}" for side in size))
    inputs = {name: halves for name in half if name} | inputs
    if right_first:
        inputs = dict(reversed(inputs.items()))
    return graph.save(path, inputs, {names[2]: outside}, element_type)


def reshaped_matcher(path: Path, rows: int) -> Path:
    """A graph that takes any size by its inputs' shapes, and only images of ``rows`` rows in truth."""
    graph = Graph()
    mean = graph.node("ReduceMean", graph.node("Add", "left", "right"), axes=(1,), keepdims=1)
    graph.node("Add", mean, graph.constant(np.ones((1, 1, rows, 1)), np.float32), name="disp")
    side: Shape = (1, 3, "h", "w")
    return graph.save(path, {"left": side, "right": side}, {"disp": (1, 1, "h", "w")})


def channel_reader(path: Path, channel: int) -> Path:
    """A graph whose "disparity" is a channel of its left input plus 10: shows what the network is fed."""
    graph = Graph()
    picked = _sliced(graph, "left", 1, channel, channel + 1)
    unused = graph.node("Mul", _sliced(graph, "right", 1, 0, 1), graph.constant(0.0, np.float32))
    graph.node("Add", graph.node("Add", picked, unused), graph.constant(10.0, np.float32), name="disp")
    side: Shape = (1, 3, "h", "w")
    return graph.save(path, {"left": side, "right": side}, {"disp": (1, 1, "h", "w")})


def sure_reader(path: Path) -> Path:
    """``channel_reader`` of red, with a second output "sure": green / 255."""
    graph = Graph()
    unused = graph.node("Mul", _sliced(graph, "right", 1, 0, 1), graph.constant(0.0, np.float32))
    red = graph.node("Add", _sliced(graph, "left", 1, 0, 1), unused)
    graph.node("Add", red, graph.constant(10.0, np.float32), name="disp")
    graph.node("Mul", _sliced(graph, "left", 1, 1, 2), graph.constant(1 / 255, np.float32), name="sure")
    side: Shape = (1, 3, "h", "w")
    outputs: dict[str, Shape] = {"disp": (1, 1, "h", "w"), "sure": (1, 1, "h", "w")}
    return graph.save(path, {"left": side, "right": side}, outputs)


def _sliced(graph: Graph, name: str, axis: int, start: int, stop: int) -> str:
    bounds = [graph.constant([value], np.int64) for value in (start, stop, axis)]
    return graph.node("Slice", name, *bounds)
