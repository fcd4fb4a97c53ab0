"""Any stereo network in an ONNX file."""

from __future__ import annotations

import dataclasses
import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.contracts.stereo import Matched
from bench.errors import BenchError, require_choice
from bench.registry import register
from bench.stereo.network import NetworkConfig, StereoNetwork
from bench.stereo.onnx_graph import CHOICES, PRESETS, StereoGraph
from bench.stereo.onnx_session import ELEMENT_TYPES, describe, find_tensor, open_session, run_session
from bench.stereo.padding import Window, next_multiple, pad_to
from bench.stereo.resizing import resize_image, resize_matched
from bench.types import Image

# Gain and offset of 8-bit colours, for each of the three channels.
_MEAN, _STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
_COLOURS = {
    "raw": (np.ones(3), np.zeros(3)),
    "unit": (np.full(3, 1 / 255), np.zeros(3)),
    "signed": (np.full(3, 2 / 255), np.full(3, -1.0)),
    "imagenet": (1 / (255 * _STD), -_MEAN / _STD),
}


@dataclass(frozen=True)
class OnnxConfig(NetworkConfig):
    """How to talk to the file. Those that are null are as the preset says; ``StereoGraph`` has the same fields."""

    preset: str = "generic"
    """What the file is made by: generic, nvtiny, left_right_disp or stereo_matching."""
    left: str | None = None
    """Name of the left image's input, or its position such as "0"."""
    right: str | None = None
    """Name of the right image's input, or its position."""
    output: str | None = None
    """Name of the disparity's output, or its position."""
    stacked: str | None = None
    """How one input (named by left) takes both views: channels for (1, 6, H, W), batch for (2, 3, H, W); "": there are
    two inputs."""
    layout: str | None = None
    """nchw or nhwc."""
    colours: str | None = None
    """unit (RGB 0 to 1), raw (0 to 255), signed (-1 to 1) or imagenet (unit, less ImageNet's mean, by its standard
    deviation)."""
    fit: str | None = None
    """resize to the size that the file fixes, pad to it, or auto: pad an image that fits and resize one that does
    not."""
    pad_multiple: int | None = None
    """A file that leaves the size open gets images padded to multiples of this."""
    pad_side: str | None = None
    """Where padding goes: top_right, bottom_right or centred."""
    unit: str | None = None
    """A disparity of 1 in the output is one pixel of the fed image (px) or its whole width (width)."""
    gain: float | None = None
    """Factor of the output, -1 for networks that give the (negative) flow."""
    confidence: str = ""
    """Output that says how sure the network is, 0 to 1 for each pixel, by name or position; empty: it has none."""
    threads: int = 0
    """CPU threads; 0: as many as torch has been given."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dtype != "float32":
            raise BenchError(f"stereo.dtype={self.dtype}: an ONNX file has its own number format; leave dtype out.")
        self.graph()

    def graph(self) -> StereoGraph:
        """The preset with the settings that were given; raises ``BenchError`` for a wrong one."""
        preset = PRESETS[require_choice("stereo.preset", self.preset, PRESETS)]
        given: dict[str, Any] = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(StereoGraph)
            if getattr(self, field.name, None) is not None
        }
        for name, accepted in CHOICES.items():
            if name in given:
                require_choice(f"stereo.{name}", given[name], accepted)
        graph = dataclasses.replace(preset, **given)
        if graph.gain == 0 or graph.pad_multiple < 1:
            raise BenchError(
                f"stereo.gain={graph.gain} must not be 0, and stereo.pad_multiple={graph.pad_multiple} not be below 1."
            )
        return graph


@register("stereo", "onnx", config=OnnxConfig)
class OnnxStereo(StereoNetwork):
    """Any stereo network in an ONNX file (stereo.weights=FILE), described by a preset and settings."""

    def __init__(self, config: OnnxConfig) -> None:
        graph = config.graph()
        if not config.weights and not graph.published:
            raise BenchError(
                "stereo=onnx needs the network's file: give stereo.weights=FILE.onnx, and stereo.preset as one of "
                f"{', '.join(PRESETS)}."
            )
        super().__init__(config, graph.published)
        assert self.weights_path is not None
        self._graph, self._path = graph, self.weights_path
        self._session = open_session(self._path, config.device, config.threads)
        inputs = self._session.get_inputs()
        names = [("left", graph.left)] if graph.stacked else [("left", graph.left), ("right", graph.right)]
        self._inputs = [find_tensor(inputs, name, setting, self._path) for setting, name in names]
        asked = [("output", graph.output)] + [("confidence", config.confidence)] * bool(config.confidence)
        self._outputs = [find_tensor(self._session.get_outputs(), name, key, self._path) for key, name in asked]
        fed = {tensor.name for tensor in self._inputs}
        if fed != {tensor.name for tensor in inputs} or len(fed) < len(names):
            raise BenchError(
                f"{self._path} has the inputs {', '.join(map(describe, inputs))}; stereo.preset={config.preset} feeds "
                f"{' and '.join(map(repr, sorted(fed)))}. Set left, right and stacked so that each is fed once."
            )
        for tensor in self._inputs:
            if tensor.type not in ELEMENT_TYPES or len(tensor.shape) != 4:
                raise BenchError(f"{self._path}: {describe(tensor)} is no image input (four sides, floating point).")
        self._size = self._fixed_size()

    @staticmethod
    def unavailable_reason() -> str | None:
        """None, or that onnxruntime is missing and how to get it."""
        if importlib.util.find_spec("onnxruntime") is None:
            return "onnxruntime is not installed; run `pip install onnxruntime`."
        return None

    def match(self, left: Image, right: Image) -> Matched:
        """One pass of the graph over a pair; raises ``BenchError`` where it refuses it or gives another shape."""
        pair, shape, window = self._fitted(left, right)
        values = [self._as_input(image) for image in pair]
        if self._graph.stacked:
            channels = 1 if self._graph.layout == "nchw" else 3
            values = [np.concatenate(values, axis=channels if self._graph.stacked == "channels" else 0)]
        feed = {
            tensor.name: value.astype(ELEMENT_TYPES[tensor.type], copy=False)
            for tensor, value in zip(self._inputs, values, strict=True)
        }
        maps = []
        outputs = run_session(self._session, [tensor.name for tensor in self._outputs], feed, self._path)
        for tensor, output in zip(self._outputs, outputs, strict=True):
            if output.size != shape[0] * shape[1]:
                raise BenchError(
                    f"{self._path}: {describe(tensor)} has the shape {output.shape} for images of {shape[0]} x "
                    f"{shape[1]}; expected one number per pixel. Choose another stereo.output or stereo.confidence, if "
                    "there is one."
                )
            maps.append(output.reshape(shape).astype(np.float32))
        # A gain in pixels of the fed image, whose width is shape[1].
        gain = self._graph.gain * (shape[1] if self._graph.unit == "width" else 1)
        disparity, confidence = maps[0] * np.float32(gain), maps[1] if len(maps) > 1 else None
        if window is None:
            return resize_matched(disparity, confidence, (left.shape[0], left.shape[1]))
        return Matched(
            np.ascontiguousarray(disparity[window]),
            None if confidence is None else np.ascontiguousarray(confidence[window]),
        )

    def _fitted(self, left: Image, right: Image) -> tuple[list[Image], tuple[int, int], Window | None]:
        """The pair at a size that the graph takes, that size, and the image's place in it (None: it was resized)."""
        height, width = left.shape[:2]
        size, graph = self._size, self._graph
        if size is None:
            size = next_multiple((height, width), graph.pad_multiple)
        elif graph.fit == "resize" or (graph.fit == "auto" and (height > size[0] or width > size[1])):
            return [resize_image(image, size) for image in (left, right)], size, None
        if height > size[0] or width > size[1]:
            raise BenchError(
                f"stereo.fit=pad: {self._path} takes images of {size[1]}x{size[0]}, and the frame is {width}x{height}. "
                "Use stereo.fit=resize, or a smaller stereo.scale."
            )
        padded = [pad_to(image, size, graph.pad_side) for image in (left, right)]
        return [image for image, _ in padded], size, padded[0][1]

    def _as_input(self, image: Image) -> npt.NDArray[np.float32]:
        gain, offset = (part.astype(np.float32) for part in _COLOURS[self._graph.colours])
        values = image * gain + offset
        if self._graph.layout == "nchw":
            values = np.ascontiguousarray(values.transpose(2, 0, 1))
        return np.asarray(values[None], np.float32)

    def _fixed_size(self) -> tuple[int, int] | None:
        """Height and width that the file fixes, or None; raises ``BenchError`` where they can't be an image's."""
        shape = self._inputs[0].shape
        sides, channels = (shape[2:], shape[1]) if self._graph.layout == "nchw" else (shape[1:3], shape[3])
        expected = 6 if self._graph.stacked == "channels" else 3
        other = shape[3] if self._graph.layout == "nchw" else shape[1]
        if channels != expected and (isinstance(channels, int) or other == expected):
            raise BenchError(
                f"{self._path}: {describe(self._inputs[0])} does not have {expected} channels where "
                f"stereo.layout={self._graph.layout} says. Try the other layout, or stereo.stacked."
            )
        fixed = [side for side in sides if isinstance(side, int) and side > 0]
        return (fixed[0], fixed[1]) if len(fixed) == 2 else None
