"""What several kinds are tested with: textured images and pairs of known disparity, threads, and equality."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import torch

from bench.authoring.verdict import ContractBrokenError
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.types import Image, StereoCamera, StereoFrame

T = TypeVar("T")

FULL_SIZE = (375, 1242)
"""Height and width of KITTI's images, at which speed is told."""


def texture(height: int, width: int, seed: int = 0) -> Image:
    """A coloured picture (H, W, 3) uint8 with structure at every scale, as walls and trees have."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, 3))
    for sigma, share in ((1.0, 1.0), (3.0, 1.0), (9.0, 0.8), (27.0, 0.6)):
        layer = cv2.GaussianBlur(rng.standard_normal((height, width, 3)), (0, 0), sigma)
        grey = layer.mean(axis=2, keepdims=True)
        layer = grey / grey.std() + 0.4 * layer / layer.std()
        total += share * layer
    return np.clip(np.rint(128 + 45 * total / total.std()), 0, 255).astype(np.uint8)


def shifted_pair(height: int, width: int, shift: int, seed: int = 0) -> tuple[Image, Image]:
    """A textured wall whose disparity is ``shift`` pixels everywhere: what the left image has at x, the right has at
    x - shift, exactly (cut from one picture, nothing is interpolated)."""
    wide = texture(height, width + shift, seed)
    return wide[:, :width].copy(), wide[:, shift:].copy()


class PairDataset(Dataset):
    """One pair as a data set, with a camera of KITTI's proportions, for plugins that are started with one."""

    label = "pair"
    numbers = (0,)

    def __init__(self, left: Image, right: Image) -> None:
        height, width = left.shape[:2]
        focal = 0.58 * width
        self.camera = StereoCamera(width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5, (0.54, 0.0, 0.0))
        self._frame = StereoFrame(0, 0.0, left, right)

    def frame(self, position: int) -> StereoFrame:
        return self._frame


def in_thread(call: Callable[[], T]) -> T:
    """What ``call`` returns or raises in a background thread, where a run's front end works."""
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="check-plugin") as pool:
        return pool.submit(call).result()


def same_arrays(first: Any, second: Any) -> bool:
    """Whether two arrays (or None) have the same shape, dtype and values; NaN equals NaN."""
    if first is None or second is None:
        return first is second
    floats = np.issubdtype(first.dtype, np.floating)
    return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=bool(floats))


def require_same(first: Any, second: Any, when: str, method: str) -> None:
    """Raise ``ContractBrokenError`` unless both results are equal to the bit; ``when`` says what was done twice."""
    if same_arrays(first, second):
        return
    difference = ""
    if first is not None and second is not None and first.shape == second.shape and first.dtype != bool:
        largest = np.nanmax(np.abs(first.astype(np.float64) - second), initial=0.0)
        difference = f" (largest difference {largest:.3g})"
    raise ContractBrokenError(
        f"{when} gave different results{difference}",
        "the same result to the bit",
        "no randomness but from a seed; reset in start() what is carried from frame to frame; "
        "in torch: model.eval(), torch.inference_mode(), no dropout",
        method,
    )


def require_untouched(what: str, before: Any, after: Any, method: str) -> None:
    """Raise ``ContractBrokenError`` if an input was changed in place."""
    if not same_arrays(before, after):
        raise ContractBrokenError(
            f"{what} was changed in place",
            "inputs stay as they are: other stages use the same arrays",
            f"work on a copy: {what.split(' ')[-1]} = {what.split(' ')[-1]}.copy()",
            method,
        )


def require_array(result: Any, shape: tuple[int, ...], dtype: type, method: str) -> None:
    """Raise ``ContractBrokenError`` unless ``result`` is a numpy array of this shape and dtype."""
    expected = f"numpy array {shape} of {np.dtype(dtype).name}"
    if not isinstance(result, np.ndarray):
        mend = "convert it: result.cpu().numpy()" if isinstance(result, torch.Tensor) else "return a numpy array"
        raise ContractBrokenError(f"{method} returned {_kind_of(result)}", expected, mend, method)
    if result.shape != shape:
        mend = "undo padding and resizing, and take away batch and channel axes: result[0, 0, :height, :width]"
        if result.shape == shape[::-1]:
            mend = "height comes first: transpose it"
        raise ContractBrokenError(f"{method} returned shape {result.shape}", expected, mend, method)
    if result.dtype != dtype:
        mend = f"result.astype(np.{np.dtype(dtype).name}{'_' if dtype is bool else ''})"
        raise ContractBrokenError(f"{method} returned {result.dtype}", expected, mend, method)


def _kind_of(value: Any) -> str:
    return "None (is a return missing?)" if value is None else f"a {type(value).__module__}.{type(value).__name__}"


def weights_of(plugin: Any) -> str:
    """The weight files that the plugin names; ``ContractBrokenError`` for one that is not there."""
    files: dict[str, Path] = getattr(plugin, "weights", dict)()
    for what, file in files.items():
        if not Path(file).is_file():
            raise ContractBrokenError(
                f"weights() names {file} for {what}, which is no file",
                "existing files, for provenance and for the cache",
                "return the paths that were really loaded",
                "weights",
            )
    return ", ".join(f"{what}: {Path(file).name}" for what, file in files.items()) or "none"


def require_frames(dataset: Dataset, least: int) -> None:
    """Raise ``BenchError`` if the data set of the surroundings is too short for a check."""
    if len(dataset) < least:
        raise BenchError(f"The data set {dataset.label} has {len(dataset)} frames; this check needs {least}.")


def through_a_file(state: Any) -> Any:
    """What a checkpoint makes of a plugin's state."""
    file = io.BytesIO()
    try:
        torch.save(state, file)
        return torch.load(io.BytesIO(file.getvalue()), weights_only=True)
    except (pickle.UnpicklingError, pickle.PicklingError, AttributeError, TypeError) as error:
        reason = str(error).strip().split("\n", 1)[0]
        raise ContractBrokenError(
            f"state() can't be kept: {reason}",
            "tensors, numbers, text, and lists and dicts of them",
            "torch.from_numpy(...) for arrays, float(...) for numpy's numbers",
            "state",
        ) from error
