"""A published network inside the worker process: imported, built, loaded, and called by its authors' convention."""

from __future__ import annotations

import importlib
import os
import pickle
import sys
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from bench.errors import BenchError
from bench.stereo.checkpoint import fit_state, load_state
from bench.stereo.device import choose_device
from bench.stereo.upstream.construction import Arguments, patched
from bench.stereo.upstream.recipe import UpstreamRecipe
from bench.types import Float, Image, Map


@dataclass(frozen=True)
class Motion:
    """What a temporal network is told of a frame: ``K`` (3, 3) of the image that is fed, padding included, the
    ``baseline`` in metres, and ``T_now_before`` (4, 4), the camera's motion since the frame before, None to begin
    anew."""

    K: Float
    baseline: float
    T_now_before: Float | None


class UpstreamModel:
    """One network on one device. Raises ``BenchError`` for a checkout, checkpoint or device that does not serve."""

    def __init__(self, recipe: UpstreamRecipe, root: Path, checkpoint: Path, device: str, trust_pickle: bool) -> None:
        """``root`` is the folder of the checkout that ``recipe.root_in`` finds."""
        self._recipe = recipe
        self._device = choose_device(device)
        if recipe.arguments.get("mixed_precision") and self._device.type != "cuda":
            raise BenchError(f"stereo.dtype=float16 needs CUDA for {recipe.title}. Use stereo.dtype=float32.")
        network = _build(recipe, root)
        fit_state(network, _read_state(checkpoint, trust_pickle), checkpoint)
        self._network = network.eval().requires_grad_(False).to(self._device)
        self._before: dict[str, Any] | None = None

    def match(self, left: Image, right: Image, iterations: int, motion: Motion | None = None) -> Map:
        """Disparity (H, W) float32 in pixels, from images (H, W, 3) whose sides fit the network.

        With ``motion`` the network sees what it made of the frame before, and this frame is remembered for the next
        one; without it, the frame stands alone and what is remembered stays.
        """
        images = [torch.tensor(image, device=self._device).permute(2, 0, 1)[None].float() for image in (left, right)]
        extra = {} if motion is None else {"params": self._params(motion)}
        with torch.no_grad(), torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True):
            output = self._network(*images, iters=iterations, test_mode=True, **extra)
        if motion is not None:
            self._before = {key: output[key] for key in ("flow_q", "net_list", "fmap1")}
        return self._as_map(output, left.shape[:2])

    def _params(self, motion: Motion) -> dict[str, Any] | None:
        """TCSM's temporal input; poses are world to camera, so the frame before is put at the origin."""
        if motion.T_now_before is None or self._before is None:
            return None
        return {
            "K": self._single(motion.K),
            "T": self._single(motion.T_now_before),
            "previous_T": self._single(np.eye(4)),
            "baseline": self._single(np.array(motion.baseline)),
            "last_disp": self._before["flow_q"],
            "last_net_list": self._before["net_list"],
            "fmap1": self._before["fmap1"],
        }

    def _single(self, values: Float) -> Tensor:
        return torch.tensor(values, dtype=torch.float32, device=self._device)[None]

    def _as_map(self, output: Any, shape: tuple[int, ...]) -> Map:
        which = self._recipe.output
        try:
            disparity = output if which is None else output[which]
        except (KeyError, IndexError, TypeError) as error:
            raise BenchError(
                f"{self._recipe.title} returned {_describe(output)} without {which!r}. {self._advice}"
            ) from (error)
        if not isinstance(disparity, Tensor) or disparity.numel() != shape[0] * shape[1]:
            raise BenchError(
                f"{self._recipe.title} returned {_describe(disparity)}; expected a tensor (1, 1, {shape[0]}, "
                f"{shape[1]}). {self._advice}"
            )
        values: Map = (self._recipe.sign * disparity.float()).reshape(shape).cpu().numpy()
        return values

    @property
    def _advice(self) -> str:
        return f"Use a checkout of {self._recipe.repository} at commit {self._recipe.tested_commit[:10]}."


def _build(recipe: UpstreamRecipe, root: Path) -> nn.Module:
    """Import the network's module from ``root`` and construct it, without downloads."""
    os.environ.update(recipe.environment)
    sys.path[:0] = [str(root / folder) for folder in recipe.import_folders]
    known = f"commit {recipe.tested_commit[:10]} of {recipe.repository} is known to work"
    try:
        with patched(recipe.patches, recipe.stand_ins, root):
            cls = getattr(importlib.import_module(recipe.module), recipe.class_name)
            network = cls(Arguments(recipe.arguments))
    except ModuleNotFoundError as error:
        raise BenchError(_missing_module(recipe, root, error)) from error
    # Whatever the authors' code raises: the user must know where.
    except Exception as error:
        raise BenchError(f"{recipe.title} can't be built from {root}: {told(error)}; {known}.") from error
    if not isinstance(network, nn.Module):
        raise BenchError(f"{recipe.class_name} of {root / recipe.module_file()} is no torch network; {known}.")
    return network


def _missing_module(recipe: UpstreamRecipe, root: Path, error: ModuleNotFoundError) -> str:
    package = str(error.name).partition(".")[0]
    if package == recipe.module.partition(".")[0]:
        return f"{recipe.title}: {root} has no module {error.name}. Is the checkout of {recipe.repository} complete?"
    advice = f"Run `{sys.executable} -m pip install --no-deps {package}`"
    return (
        f"{recipe.title} needs the Python module '{error.name}', which {sys.executable} does not have. {advice}, "
        "or set stereo.python to the interpreter of an environment made by the network's own instructions."
    )


def _read_state(checkpoint: Path, trust_pickle: bool) -> Mapping[str, Tensor]:
    """The checkpoint's tensors; with ``trust_pickle`` also out of a file that runs code when it is read."""
    try:
        return load_state(checkpoint)
    except BenchError as error:
        if not isinstance(error.__cause__, pickle.UnpicklingError):
            raise
        if not trust_pickle:
            raise BenchError(
                f"{error} If you trust where it comes from as you trust a program, stereo.trust_pickle=true reads it "
                "all the same."
            ) from error
    content = torch.load(checkpoint, map_location="cpu", weights_only=False)
    for key in ("state_dict", "model"):
        if isinstance(content, Mapping) and key in content:
            content = content[key]
    if isinstance(content, nn.Module):
        content = content.state_dict()
    if not isinstance(content, Mapping):
        raise BenchError(f"The checkpoint {checkpoint} holds {_describe(content)}; expected a network's tensors.")
    return {str(key).removeprefix("module."): value for key, value in content.items() if isinstance(value, Tensor)}


def told(error: Exception) -> str:
    """Type, text and place of an error, in one line."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    first_line = (str(error) or "no message").split("\n", 1)[0]
    return f"{type(error).__name__}: {first_line} (line {last.lineno} of {last.filename})"


def _describe(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"a tensor {tuple(value.shape)}"
    if isinstance(value, Mapping):
        return f"a {type(value).__name__} with {', '.join(map(str, value))}"
    return f"a {type(value).__name__}" + (f" of {len(value)}" if isinstance(value, (list, tuple)) else "")
