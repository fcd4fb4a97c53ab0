"""Any stereo network in an ONNX file whose inputs are images."""

from __future__ import annotations

import dataclasses
import importlib.util
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contracts.stereo import Matched
from bench.errors import BenchError, require_choice, require_least
from bench.registry import register
from bench.stereo.network import NetworkConfig, StereoNetwork
from bench.stereo.onnx_graph import CHOICES, PRESETS, StereoGraph
from bench.stereo.onnx_inputs import array_of, fixed_sides, read_feeds
from bench.stereo.onnx_outputs import choose_output, map_in
from bench.stereo.onnx_session import describe, find_tensor, open_session, run_session
from bench.stereo.padding import Window, next_multiple, pad_to
from bench.stereo.resizing import resize_image, resize_matched
from bench.types import Image

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class OnnxConfig(NetworkConfig):
    """How to talk to the file. Those that are null are as the preset says; the preset generic reads from the file's
    inputs what it can, and the log says what it read. ``StereoGraph`` has the same fields."""

    preset: str = "generic"
    """What the file is made by: generic, nvtiny, left_right_disp or stereo_matching."""
    left: str | None = None
    """Name of the left image's input, or its position such as "0"; "": told by the names (left and right, L and R,
    image1 and image2), else the first."""
    right: str | None = None
    """Name of the right image's input, or its position; "": the other one."""
    half_left: str | None = None
    """A file of four inputs, as CREStereo's in two stages, takes both images at half size too: name or position of
    the left one's input; "": told by sizes and names (init_left beside next_left)."""
    half_right: str | None = None
    """The same of the right image."""
    output: str | None = None
    """Name of the disparity's output, or its position; "": the one called disp or flow, else the first."""
    channel: int | None = None
    """Which of several maps in the output is the disparity, from 0, -1 is the last; null: of two (a flow) the first."""
    stacked: str | None = None
    """How one input (named by left) takes both views: channels for (1, 6, H, W), or (1, 2, H, W) in grey; batch for
    (2, 3, H, W); "": there are two inputs; auto: as the number of inputs and their shape say."""
    layout: str | None = None
    """nchw, nhwc, or auto: as the inputs' shape says."""
    grey: bool | None = None
    """Feed grey images, one channel a view; null: as the inputs' channels say."""
    bgr: bool | None = None
    """Feed blue, green, red instead of red, green, blue."""
    colours: str | None = None
    """unit (RGB 0 to 1), raw (0 to 255), signed (-1 to 1) or imagenet (unit, less ImageNet's mean, by its standard
    deviation)."""
    mean: tuple[float, ...] = ()
    """Taken from the colours as given by ``colours``, one number a channel or one for all, ..."""
    std: tuple[float, ...] = ()
    """... which are then divided by this."""
    fit: str | None = None
    """resize to the size that the file fixes, pad to it, or auto: pad an image that fits and resize one that does
    not."""
    pad_multiple: int | None = None
    """Sides that the file leaves open get multiples of this."""
    pad_side: str | None = None
    """Where padding goes: top_right, bottom_right or centred."""
    unit: str | None = None
    """A disparity of 1 in the output is one pixel of the fed image (px), one pixel of the output, which may be smaller
    (output), or the image's whole width (width)."""
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
        for name, values in (("mean", self.mean), ("std", self.std)):
            if len(values) not in (0, 1, 3) or (name == "std" and not all(value > 0 for value in values)):
                numbers = "numbers above 0" if name == "std" else "numbers"
                raise BenchError(f"stereo.{name}={list(values)} must be one or three {numbers}, for example [0.5].")
        require_least("stereo", self, threads=0, **({} if self.channel is None else {"channel": 0}))
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
    """A stereo network in an ONNX file (stereo.weights=FILE); a preset, settings and the file's inputs describe it."""

    def __init__(self, config: OnnxConfig) -> None:
        graph = config.graph()
        if not config.weights and not graph.published:
            raise BenchError(f"stereo=onnx needs the network's file: {self.missing_weights()}.")
        super().__init__(config, graph.published)
        assert self.weights_path is not None
        self._graph, self._path = graph, self.weights_path
        self._session = open_session(self._path, config.device, config.threads)
        self._feeds = read_feeds(self._session.get_inputs(), graph, self._path)
        self._sides = fixed_sides(self._feeds, self._path)
        outputs = self._session.get_outputs()
        self._outputs = [choose_output(outputs, graph.output, self._path)]
        if config.confidence:
            self._outputs.append(find_tensor(outputs, config.confidence, "confidence", self._path))
        self._is_told = False

    @staticmethod
    def unavailable_reason() -> str | None:
        """None, or that onnxruntime is missing and how to get it."""
        if importlib.util.find_spec("onnxruntime") is None:
            return "onnxruntime is not installed; run `pip install onnxruntime`."
        return None

    @staticmethod
    def missing_weights() -> str | None:
        """It is nothing without a file."""
        return f"give stereo.weights=FILE.onnx, and stereo.preset as one of {', '.join(PRESETS)}"

    @property
    def sign_cure(self) -> str:
        """The setting that turns the sign."""
        return f"set stereo.gain={-self._graph.gain:g}"

    @property
    def unit_cure(self) -> str:
        """The settings that say in which unit the output is."""
        now = f"stereo.gain={self._graph.gain:g} stereo.unit={self._graph.unit}"
        return f"Change {now} (gain=0.00390625 for KITTI's coding, unit=width for shares of the width)"

    def match(self, left: Image, right: Image) -> Matched:
        """One pass of the graph over a pair; raises ``BenchError`` where it refuses it or gives another shape."""
        self._tell()
        pair, fed, window = self._fitted(left, right)
        feed = {each.tensor.name: array_of(each, pair, self._graph, self._path) for each in self._feeds}
        answers = run_session(self._session, [tensor.name for tensor in self._outputs], feed, self._path)
        disparity = map_in(answers[0], self._outputs[0], self._graph.channel, fed, self._path)
        confidence = map_in(answers[1], self._outputs[1], None, fed, self._path) if len(answers) > 1 else None
        # In pixels of the map as it came, which resizing turns into those of the larger image.
        unit = {"px": disparity.shape[1] / fed[1], "output": 1, "width": disparity.shape[1]}[self._graph.unit]
        matched = Matched(disparity * np.float32(self._graph.gain * unit), confidence)
        shape = fed if window is not None else left.shape[:2]
        if any(each is not None and each.shape != shape for each in matched):
            matched = resize_matched(
                disparity=matched.disparity, confidence=matched.confidence, shape=(shape[0], shape[1])
            )
        if window is None:
            return matched
        disparity, confidence = matched
        return Matched(
            np.ascontiguousarray(disparity[window]),
            None if confidence is None else np.ascontiguousarray(confidence[window]),
        )

    def _tell(self) -> None:
        """Say once what was read from the file; not before the first pair, as a run's log begins after its parts."""
        if self._is_told:
            return
        self._is_told = True
        read = "; ".join([*(feed.in_words() for feed in self._feeds), f"disparity: {describe(self._outputs[0])}"])
        graph = self._graph
        log.info("%s: %s, stereo.unit=%s, stereo.gain=%g", self._path.name, read, graph.unit, graph.gain)

    def _fitted(self, left: Image, right: Image) -> tuple[dict[str, Image], tuple[int, int], Window | None]:
        """The pair at a size that the graph takes, that size, and the image's place in it (None: it was resized)."""
        shape, sides, graph = (left.shape[0], left.shape[1]), self._sides, self._graph
        too_large = any(fixed is not None and fixed < side for fixed, side in zip(sides, shape, strict=True))
        open_sides = next_multiple(shape, graph.pad_multiple)
        if any(sides) and (graph.fit == "resize" or (graph.fit == "auto" and too_large)):
            # A side that the file leaves open shrinks or grows with the other.
            ratio = next(fixed / side for fixed, side in zip(sides, shape, strict=True) if fixed)
            scaled = (max(1, round(shape[0] * ratio)), max(1, round(shape[1] * ratio)))
            open_sides = next_multiple(scaled, graph.pad_multiple)
            size = (sides[0] or open_sides[0], sides[1] or open_sides[1])
            return {"left": resize_image(left, size), "right": resize_image(right, size)}, size, None
        size = (sides[0] or open_sides[0], sides[1] or open_sides[1])
        if too_large:
            raise BenchError(
                f"stereo.fit=pad: {self._path} takes images of {size[1]}x{size[0]}, and the frame is "
                f"{shape[1]}x{shape[0]}. Use stereo.fit=resize, or a smaller stereo.scale."
            )
        (padded_left, window), (padded_right, _) = (pad_to(image, size, graph.pad_side) for image in (left, right))
        return {"left": padded_left, "right": padded_right}, size, window
