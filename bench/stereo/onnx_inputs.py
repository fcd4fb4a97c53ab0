"""Which view each input of an ONNX stereo network takes, and how: as settings say, else as the inputs tell."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.io.images import grey
from bench.stereo.onnx_graph import StereoGraph
from bench.stereo.onnx_session import ELEMENT_TYPES, describe, find_tensor
from bench.stereo.resizing import resize_image
from bench.types import Image

Sides = tuple[int | None, int | None]
"""Height and width, None where the file leaves it open."""

# Gain and offset of 8-bit colours, for each of the three channels.
_MEAN, _STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
_COLOURS = {
    "raw": (np.ones(3), np.zeros(3)),
    "unit": (np.full(3, 1 / 255), np.zeros(3)),
    "signed": (np.full(3, 2 / 255), np.full(3, -1.0)),
    "imagenet": (1 / (255 * _STD), -_MEAN / _STD),
}
# How exporters call the smaller pair of a network in two stages (CREStereo: init_left beside next_left).
_SMALL = ("init", "half", "small", "low", "coarse")


@dataclass(frozen=True)
class Feed:
    """An input of a graph: the ``views`` it takes (both where they are stacked along ``axis``), grey or in colour, at
    half of the fed size or not, and the ``sides`` of an image that it fixes."""

    tensor: Any
    views: tuple[str, ...]
    axis: int
    layout: str
    is_grey: bool
    is_half: bool
    sides: Sides

    def in_words(self) -> str:
        """For the log: left = 'input' (1, 1, H, W) float, grey."""
        about = ", ".join(
            word
            for word, holds in (("grey", self.is_grey), ("at half size", self.is_half), (self.layout, True))
            if holds
        )
        return f"{' and '.join(self.views)}: {describe(self.tensor)}, {about}"


def read_feeds(inputs: Sequence[Any], graph: StereoGraph, path: Path) -> list[Feed]:
    """What each input of the file is fed; raises ``BenchError``, with the inputs' shapes and the setting that helps,
    where neither the settings nor the inputs tell."""
    for tensor in inputs:
        if tensor.type not in ELEMENT_TYPES or len(tensor.shape) != 4:
            raise BenchError(
                f"{path}: the input {describe(tensor)} is no image (four sides: batch, channels, height, width; numbers"
                "). Export the network with images as its only inputs."
            )
    if graph.stacked in ("channels", "batch") or (graph.stacked == "auto" and len(inputs) == 1):
        return [_stacked(inputs, graph, path)]
    roles = _roles(inputs, graph, path)
    return [_feed(tensor, (role.removeprefix("half_"),), graph, path, role) for role, tensor in roles.items()]


def fixed_sides(feeds: Sequence[Feed], path: Path) -> Sides:
    """Height and width that the file fixes for the full image; raises ``BenchError`` where inputs disagree."""
    found = []
    for side in (0, 1):
        fixed = {own * (2 if feed.is_half else 1) for feed in feeds if (own := feed.sides[side]) is not None}
        if len(fixed) > 1:
            shapes = ", ".join(describe(feed.tensor) for feed in feeds)
            raise BenchError(
                f"{path}: the inputs {shapes} have no one size. Say which take the full images: stereo.left and "
                "stereo.right, and which those of half size: stereo.half_left and stereo.half_right."
            )
        found.append(next(iter(fixed), None))
    return found[0], found[1]


def array_of(feed: Feed, pair: dict[str, Image], graph: StereoGraph, path: Path) -> npt.NDArray[Any]:
    """What the input is given of the fitted pair (``left`` and ``right``, (H, W, 3) uint8 RGB)."""
    views = [_view(feed, pair[view], graph) for view in feed.views]
    values = np.concatenate(views, axis=feed.axis) if len(views) > 1 else views[0]
    dtype = np.dtype(ELEMENT_TYPES[feed.tensor.type])
    if np.issubdtype(dtype, np.integer):
        values, limits = np.rint(values), np.iinfo(dtype)
        if values.min() < limits.min or values.max() > limits.max:
            raise BenchError(
                f"{path}: {describe(feed.tensor)} holds {limits.min} to {limits.max}, and by stereo.colours="
                f"{graph.colours} the image has {values.min():g} to {values.max():g}. Set stereo.mean and stereo.std, "
                "for example stereo.mean=[128]: (value - mean) / std is fed."
            )
    return values.astype(dtype, copy=False)


def _view(feed: Feed, image: Image, graph: StereoGraph) -> npt.NDArray[np.float32]:
    """One view, normalised, as (1, C, H, W) or (1, H, W, C)."""
    if feed.is_half:
        full, own = image.shape[:2], feed.sides
        image = resize_image(image, (own[0] or full[0] // 2, own[1] or full[1] // 2))
    if graph.bgr:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2BGR), np.uint8)
    gain, offset = _COLOURS[graph.colours]
    if feed.is_grey:
        image, gain, offset = grey(image)[..., None], gain.mean(keepdims=True), offset.mean(keepdims=True)
    if graph.mean or graph.std:
        std = np.array(graph.std or 1.0)
        gain, offset = gain / std, (offset - np.array(graph.mean or 0.0)) / std
    values = image * gain.astype(np.float32) + offset.astype(np.float32)
    if feed.layout == "nchw":
        values = np.ascontiguousarray(values.transpose(2, 0, 1))
    return np.asarray(values[None], np.float32)


def _stacked(inputs: Sequence[Any], graph: StereoGraph, path: Path) -> Feed:
    """The one input that takes both views."""
    tensor = find_tensor(inputs, graph.left or "0", "left", path)
    if len(inputs) > 1:
        _refuse(inputs, path, f"stereo.stacked={graph.stacked} feeds '{tensor.name}' alone. Leave stacked out")
    if graph.stacked == "auto":
        channels = [side for side in (tensor.shape[1], tensor.shape[3]) if side in (1, 2, 3, 6)]
        # Of one or three channels it can hold two views only as a batch.
        batch = bool(channels) and channels[0] in (1, 3)
        if batch and isinstance(tensor.shape[0], int) and tensor.shape[0] not in (2, -1):
            _refuse(inputs, path, "one input of one image is no stereo network")
        stacked = "batch" if batch else "channels"
    else:
        stacked = graph.stacked
    return _feed(tensor, ("left", "right"), graph, path, "left", stacked)


def _roles(inputs: Sequence[Any], graph: StereoGraph, path: Path) -> dict[str, Any]:
    """Inputs by role: left, right, and half_left, half_right where the file takes the pair at half size too."""
    wanted = {role: str(getattr(graph, role)) for role in ("left", "right", "half_left", "half_right")}
    roles = {role: find_tensor(inputs, name, role, path) for role, name in wanted.items() if name}
    rest = [tensor for tensor in inputs if all(tensor.name != taken.name for taken in roles.values())]
    if len(inputs) == 2 and len(rest) + len(roles) == 2:
        roles |= dict(zip((role for role in ("left", "right") if role not in roles), _in_order(rest), strict=True))
    elif len(inputs) == 4 and not roles:
        roles = _of_four(inputs)
    names = [tensor.name for tensor in roles.values()]
    if sorted(names) != sorted(tensor.name for tensor in inputs) or not {"left", "right"} <= set(roles):
        fed = " and ".join(map(repr, sorted(set(names)))) or "none of them"
        raise BenchError(
            f"{path} has the inputs {', '.join(map(describe, inputs))}, and {fed} would be fed. Set stereo.left and "
            "stereo.right (of a file with two sizes stereo.half_left and stereo.half_right too, of one input "
            "stereo.stacked) so that each is fed once."
        )
    return roles


def _of_four(inputs: Sequence[Any]) -> dict[str, Any]:
    """Both views at full and at half size, told by names and sizes; empty where those do not tell."""
    roles: dict[str, Any] = {}
    for side in ("left", "right"):
        pair = [tensor for tensor in inputs if _side_of(tensor.name) == side]
        half = _half_of(pair) if len(pair) == 2 else None
        if half is None:
            return {}
        roles[side], roles[f"half_{side}"] = next(tensor for tensor in pair if tensor is not half), half
    return roles


def _half_of(pair: Sequence[Any]) -> Any:
    """The smaller of two inputs by its fixed size, else by its name; None where neither tells."""
    fixed = [tensor.shape[1:] for tensor in pair]
    if all(isinstance(side, int) for shape in fixed for side in shape) and fixed[0] != fixed[1]:
        return min(pair, key=lambda tensor: math.prod(tensor.shape[1:]))
    small = [tensor for tensor in pair if any(word in tensor.name.lower() for word in _SMALL)]
    return small[0] if len(small) == 1 else None


def _in_order(tensors: Sequence[Any]) -> list[Any]:
    """The left input before the right one as their names tell it (left and right, L and R, image1 and image2), else in
    the file's order."""
    if sorted(_side_of(tensor.name) for tensor in tensors) == ["left", "right"]:
        return sorted(tensors, key=lambda tensor: _side_of(tensor.name))
    parts = [re.fullmatch(r"(.*?)(\d+)(\D*)", tensor.name) for tensor in tensors]
    if len({(part[1], part[3]) for part in parts if part}) == 1 and all(parts):
        return sorted(tensors, key=lambda tensor: int(re.findall(r"\d+", tensor.name)[-1]))
    return list(tensors)


def _side_of(name: str) -> str:
    """ "left", "right", or "" where the name tells neither."""
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)]
    return next((side for side in ("left", "right") if side in name.lower() or side[0] in words), "")


def _feed(tensor: Any, views: tuple[str, ...], graph: StereoGraph, path: Path, role: str, stacked: str = "") -> Feed:
    """The form of an input, by its shape; raises ``BenchError`` for settings that do not go with it."""
    two = 2 if stacked == "channels" else 1
    accepted = (two, 3 * two)
    shape = tensor.shape
    layout = graph.layout
    if layout == "auto":
        layout = "nhwc" if shape[3] in accepted and shape[1] not in accepted else "nchw"
    channels, other = (shape[1], shape[3]) if layout == "nchw" else (shape[3], shape[1])
    if channels not in accepted and (other in accepted or (isinstance(channels, int) and channels > 0)):
        raise BenchError(
            f"{path}: {describe(tensor)} does not have {accepted[0]} or {accepted[1]} channels where "
            f"stereo.layout={layout} says (stereo.stacked={stacked or graph.stacked or 'none'}). Try the other layout, "
            "or set stereo.stacked."
        )
    if np.issubdtype(ELEMENT_TYPES[tensor.type], np.integer) and graph.colours != "raw" and not graph.std:
        raise BenchError(
            f"{path}: {describe(tensor)} takes whole numbers, and stereo.colours={graph.colours} feeds fractions. Use "
            "stereo.colours=raw (0 to 255)."
        )
    is_grey = channels == two or (channels != 3 * two and bool(graph.grey))
    if graph.grey is not None and graph.grey != is_grey:
        raise BenchError(
            f"{path}: {describe(tensor)} takes {'grey' if is_grey else 'colour'} images; leave stereo.grey out."
        )
    sides = shape[2:] if layout == "nchw" else shape[1:3]
    height, width = (side if isinstance(side, int) and side > 0 else None for side in sides)
    axis = 0 if stacked == "batch" else 1 if layout == "nchw" else 3
    return Feed(tensor, views, axis, layout, is_grey, role.startswith("half_"), (height, width))


def _refuse(inputs: Sequence[Any], path: Path, why: str) -> NoReturn:
    raise BenchError(f"{path} has the input{'s' * (len(inputs) > 1)} {', '.join(map(describe, inputs))}: {why}.")
