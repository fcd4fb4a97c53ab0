"""Open an ONNX file with onnxruntime, and find its inputs and outputs by name or position."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.errors import BenchError, did_you_mean
from bench.io.file_kind import what_it_is
from bench.stereo.device import choose_device

# Element types of images that a graph may take; quantised networks take whole numbers.
ELEMENT_TYPES: dict[str, type[np.number[Any]]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    **{f"tensor({each.__name__})": each for each in (np.uint8, np.int8, np.uint16, np.int16, np.int32, np.int64)},
}


def open_session(path: Path, device: str, threads: int) -> Any:
    """An ``onnxruntime.InferenceSession``, deterministic, on CUDA or the CPU.

    ``threads`` is for the CPU; 0 takes as many as torch has been given. Raises ``BenchError`` for a file that
    onnxruntime can't read, and for ``device=cuda`` where it has no CUDA.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads or torch.get_num_threads()
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    # Idle threads that spin take the cores from the stages that run beside stereo.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # Warnings about the file's style are no concern of the user.
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=_providers(device, onnxruntime))
    # onnxruntime raises a dozen own classes, none of them public.
    except Exception as error:
        reason = _first_line(error)
        unknown = f"{reason}. Is it an ONNX file, with the side files (*.data) that it names beside it?"
        raise BenchError(f"onnxruntime can't open {path}: {what_it_is(path) or unknown}") from error


def find_tensor(tensors: Sequence[Any], wanted: str, setting: str, path: Path) -> Any:
    """The input or output called ``wanted``, or at that position ("0", ...); ``BenchError`` lists what there is."""
    names = [tensor.name for tensor in tensors]
    if wanted in names:
        return tensors[names.index(wanted)]
    if wanted.isdigit() and int(wanted) < len(tensors):
        return tensors[int(wanted)]
    raise BenchError(
        f"stereo.{setting}={wanted}: {path} has {', '.join(describe(tensor) for tensor in tensors)}, and no "
        f"'{wanted}' among them.{did_you_mean(wanted, names)} Give one of these names, or its position from 0."
    )


def describe(tensor: Any) -> str:
    """An input or output in words: 'left' (1, 3, H, W) float."""
    shape = ", ".join("?" if side is None else str(side) for side in tensor.shape)
    return f"'{tensor.name}' ({shape}) {tensor.type.removeprefix('tensor(').removesuffix(')')}"


def run_session(session: Any, outputs: list[str], feed: dict[str, Any], path: Path) -> list[Any]:
    """``session.run``; raises ``BenchError`` with what was fed where the graph refuses it."""
    try:
        answer: list[Any] = session.run(outputs, feed)
    except Exception as error:
        fed = ", ".join(f"'{name}' {value.shape} {value.dtype}" for name, value in feed.items())
        raise BenchError(
            f"{path} can't compute with {fed}: {_first_line(error)}. Do stereo.fit, pad_multiple, layout and "
            "grey describe this network?"
        ) from error
    return answer


def _providers(device: str, onnxruntime: Any) -> list[str]:
    has_cuda = "CUDAExecutionProvider" in onnxruntime.get_available_providers()
    if device == "auto":
        return ["CUDAExecutionProvider", "CPUExecutionProvider"] if has_cuda else ["CPUExecutionProvider"]
    if choose_device(device).type == "cpu":
        return ["CPUExecutionProvider"]
    if not has_cuda:
        raise BenchError(f"stereo.device={device}: this onnxruntime has no CUDA. Install onnxruntime-gpu, or use cpu.")
    return ["CUDAExecutionProvider", "CPUExecutionProvider"]


def _first_line(error: Exception) -> str:
    """The error's first line without the place in onnxruntime's source and its C++ signature."""
    line = str(error).strip().split("\n", 1)[0].rstrip(".")
    return re.sub(r"/onnxruntime_src/\S+ .+?\) (?=[A-Z])", " ", line)
