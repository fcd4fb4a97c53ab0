"""An ONNX network with one image in and one map out, run by onnxruntime on the CPU."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch

from bench.errors import BenchError, did_you_mean
from bench.io.file_kind import what_it_is
from bench.types import Image

# Mean and standard deviation of ImageNet's RGB values in [0, 1], which networks pretrained on it expect.
_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_STD = np.array([0.229, 0.224, 0.225], np.float32)
_NORMALISED = ((np.arange(256)[None] / 255 - _MEAN[:, None]) / _STD[:, None]).astype(np.float32)


def missing_onnxruntime() -> str | None:
    """The command that mends it where onnxruntime is not installed, else None."""
    return None if find_spec("onnxruntime") else "onnxruntime is not installed. Run: pip install onnxruntime"


def normalised(image: Image, size: tuple[int, int]) -> npt.NDArray[np.float32]:
    """RGB uint8 (H, W, 3) resized to ``size`` = (height, width), less ImageNet's mean, by its deviation, (1, 3, h, w).

    Shrinking averages, so that what is thinner than a pixel does not vanish.
    """
    height, width = size
    shrinks = height <= image.shape[0] and width <= image.shape[1]
    resized = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    planes = np.empty((1, 3, height, width), np.float32)
    for channel in range(3):
        cv2.LUT(resized[..., channel], _NORMALISED[channel], planes[0, channel])
    return planes


class OnnxNetwork:
    """Loads the file once. ``input_name`` and ``output_name`` may be empty where the file has one input, or for the
    first output; ``setting`` (such as ``"sky"``) begins the settings' names in messages."""

    def __init__(self, path: Path, setting: str, input_name: str = "", output_name: str = "") -> None:
        """Raises ``BenchError`` where the file is missing, is no ONNX file, or has other inputs or outputs."""
        self.path = path
        if not path.is_file():
            raise BenchError(f"{setting}.weights: there is no file {path}. Give the path of an ONNX file.")
        self._session = _open(path, setting)
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        if not input_name and len(inputs) > 1:
            raise BenchError(f"{path} has the inputs {_described(inputs)}; say which one takes the image: "
                             f"{setting}.input_name=NAME.")  # fmt: skip
        taken = _named(inputs, input_name, path, f"{setting}.input_name")
        self._output = _named(outputs, output_name, path, f"{setting}.output_name").name
        self._input = taken.name
        shape = list(taken.shape)
        if taken.type != "tensor(float)" or len(shape) != 4 or (isinstance(shape[1], int) and shape[1] != 3):
            raise BenchError(
                f"{path}: the input is {_described([taken])}; expected float32 [N, 3, height, width]. Export the "
                "network with such an input."
            )
        self.size: tuple[int, int] | None = None
        """(height, width) that the file demands, None where it takes any."""
        if isinstance(shape[2], int) and isinstance(shape[3], int):
            self.size = shape[2], shape[3]

    def run(self, planes: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """The output for one normalised image (1, 3, h, w), without the batch dimension: (C, h', w') float32."""
        (output,) = self._session.run([self._output], {self._input: planes})
        if output.ndim != 4 or output.shape[0] != 1:
            raise BenchError(
                f"{self.path}: the output '{self._output}' has the shape {list(output.shape)} for one image; expected "
                "[1, classes, height, width]. Export the network so that it returns the map alone."
            )
        return np.asarray(output[0], np.float32)


def _open(path: Path, setting: str) -> Any:
    # It takes a while to import, and not every run has a network.
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    # Waiting threads would otherwise take the cores from the mapper.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no common class but this one
        reason = what_it_is(path) or " ".join(str(error).split())
        raise BenchError(
            f"{setting}.weights: {path} can't be loaded as an ONNX network ({reason}). Copy or export it again."
        ) from error


def _named(values: list[Any], name: str, path: Path, setting: str) -> Any:
    if not name:
        return values[0]
    names = [value.name for value in values]
    if name not in names:
        raise BenchError(
            f"{setting}={name}: {path} has no such name; it has {_described(values)}.{did_you_mean(name, names)}"
        )
    return values[names.index(name)]


def _described(values: list[Any]) -> str:
    return ", ".join(f"'{value.name}' {value.type} {list(value.shape)}" for value in values)
