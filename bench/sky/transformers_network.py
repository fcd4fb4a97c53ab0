"""SegFormer from a folder as Hugging Face has it, run by the optional package ``transformers``."""

from __future__ import annotations

import importlib
import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from bench.errors import BenchError, require_choice
from bench.io.text_files import read_text

# Number of the class sky among the training labels of Cityscapes.
CITYSCAPES_SKY = 10
_WEIGHT_FILES = ("model.safetensors", "pytorch_model.bin")


class TransformersNetwork:
    """Loads the folder once; ``setting`` (such as ``"sky"``) begins the settings' names in messages."""

    size: tuple[int, int] | None = None
    """None: it takes any size."""

    def __init__(self, folder: Path, setting: str, device: str) -> None:
        """Raises ``BenchError`` where ``transformers`` or the weights are missing, or the folder can't be loaded."""
        require_choice(f"{setting}.device", device, ["auto", "cpu", "cuda"])
        if device == "cuda" and not torch.cuda.is_available():
            raise BenchError(f"{setting}.device=cuda: torch finds no CUDA device. Choose {setting}.device=auto or cpu.")
        if find_spec("transformers") is None:
            raise BenchError(
                f"{setting}.weights: {folder} is a Hugging Face folder, and the package transformers, which reads it, "
                "is not installed. Run: pip install transformers (or give an ONNX file)."
            )
        weights = next((folder / name for name in _WEIGHT_FILES if (folder / name).is_file()), None)
        if weights is None:
            raise BenchError(
                f"{setting}.weights: {folder} has neither {' nor '.join(_WEIGHT_FILES)}. Fetch one of them beside "
                "config.json."
            )
        self.path = weights
        self.sky_class = _sky_class(folder / "config.json")
        on_gpu = device == "cuda" or (device == "auto" and torch.cuda.is_available())
        self._device = torch.device("cuda" if on_gpu else "cpu")
        self._model = _load(folder, setting).to(self._device).eval()

    def run(self, planes: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Logits (classes, h/4, w/4) float32 of one normalised image (1, 3, h, w)."""
        with torch.inference_mode():
            logits: torch.Tensor = self._model(pixel_values=torch.from_numpy(planes).to(self._device)).logits
        return np.asarray(logits[0].float().cpu().numpy(), np.float32)


def _load(folder: Path, setting: str) -> torch.nn.Module:
    # It takes seconds to import, and is optional.
    try:
        segformer = importlib.import_module("transformers").SegformerForSemanticSegmentation
        model: torch.nn.Module = segformer.from_pretrained(str(folder), local_files_only=True)
    except Exception as error:  # the package wraps what goes wrong inside in many ways
        reason = " ".join(str(error).split())
        raise BenchError(
            f"{setting}.weights: transformers can't load SegFormer from {folder} ({reason}). Fetch the folder again, "
            "or give an ONNX file."
        ) from error
    return model


def _sky_class(path: Path) -> int:
    try:
        labels = json.loads(read_text(path)).get("label2id") or {}
    except (ValueError, AttributeError) as error:
        raise BenchError(f"{path} can't be read as JSON ({error}). Fetch it again.") from error
    return int(labels.get("sky", CITYSCAPES_SKY))
