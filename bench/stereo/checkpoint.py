"""Read a checkpoint without running code from it, and put it into a network only if every key fits."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from bench.errors import BenchError
from bench.io.file_kind import what_it_is
from bench.io.torch_files import load_tensors

# Under which key training scripts save the network's tensors, beside the epoch, the optimizer and the like.
_WRAPPERS = ("state_dict", "model_state_dict", "model", "net", "network", "params", "weights")
# How deep such keys may lie in each other.
_DEPTH = 4
_SHOWN = 3
# Counted by batch normalisation in training and never read afterwards; older checkpoints lack it.
_COUNTER = "num_batches_tracked"


def load_state(path: Path) -> dict[str, torch.Tensor]:
    """The tensors of a checkpoint by key, on the CPU, without the ``module.`` of data-parallel training.

    Nothing but tensors and plain data is unpickled. Raises ``BenchError`` for a file that is missing, damaged, holds a
    pickled network (reading it would run its code), or holds no tensors.
    """
    if not path.exists():
        raise BenchError(f"The checkpoint {path} does not exist. Correct the path, or leave stereo.weights out.")
    try:
        content = load_tensors(path)
    except BenchError:
        raise
    # The unpickler raises whatever the damage leads to; all of it means the same to the user.
    except Exception as error:
        foreign = re.search(r"[Uu]nsupported (?:global: GLOBAL|class) ([\w.]+)", str(error))
        if foreign:
            raise BenchError(
                f"The checkpoint {path} holds a pickled Python object ({foreign[1]}), not only tensors; reading it "
                "would run code from the file. Load it with the network's own code, save `model.state_dict()` with "
                "torch.save, and give that file."
            ) from error
        damaged = "it is damaged, or no file of torch.save (an ONNX file is for stereo=onnx). Fetch it again"
        raise BenchError(
            f"The checkpoint {path} can't be read: {what_it_is(path) or damaged} ({type(error).__name__})."
        ) from error
    state = _tensors(content)
    if not state:
        several = [str(key) for key in content if _tensors(content[key])] if isinstance(content, Mapping) else []
        if several:
            raise BenchError(
                f"The checkpoint {path} holds several sets of tensors ({_first(several)}). Save the one that is "
                f"wanted: torch.save(torch.load(path)['{several[0]}'], 'net.pth')."
            )
        keys = f" with the keys {_first(list(content))}" if isinstance(content, Mapping) else ""
        raise BenchError(
            f"The checkpoint {path} holds a {type(content).__name__}{keys}, but no tensors by name. Give a file made "
            "with torch.save(model.state_dict(), path)."
        )
    return state


def fit_state(
    network: torch.nn.Module, state: Mapping[str, torch.Tensor], path: Path, ignore: Sequence[str] = ()
) -> None:
    """Load ``state`` into ``network``; raises ``BenchError`` that counts and names the keys that do not fit.

    ``ignore`` holds prefixes of keys in the file for parts that the network does without. ``path`` is for the message.
    """
    wanted = network.state_dict()
    offered = _without_prefix(dict(state), wanted)
    offered = {key: value for key, value in offered.items() if not key.startswith(tuple(ignore))}
    missing = [key for key in wanted if key not in offered and not key.endswith(_COUNTER)]
    unexpected = [key for key in offered if key not in wanted]
    reshaped = [
        f"{key}: file {tuple(offered[key].shape)}, network {tuple(wanted[key].shape)}"
        for key in wanted
        if key in offered and offered[key].shape != wanted[key].shape
    ]
    found = [
        f"{len(keys)} {what} ({_first(keys)})"
        for what, keys in (("missing", missing), ("unexpected", unexpected), ("of another shape", reshaped))
        if keys
    ]
    if found:
        raise BenchError(
            f"The checkpoint {path} does not fit {type(network).__name__}: of {len(wanted)} keys "
            f"{', '.join(found)}. Is it of another network, or of other settings?"
        )
    network.load_state_dict(offered, strict=False)


def _tensors(content: Any, depth: int = _DEPTH) -> dict[str, torch.Tensor]:
    """The named tensors in what a file held: those under a known key if there is one, else those at the top, else those
    of the only dict that holds some."""
    if not isinstance(content, Mapping) or not depth:
        return {}
    # An optimizer's tensors are no network.
    others = {str(key): value for key, value in content.items() if "optim" not in str(key)}
    inside = {key: found for key, value in others.items() if (found := _tensors(value, depth - 1))}
    for key in _WRAPPERS:
        if key in inside:
            return inside[key]
    tensors = {str(key): value for key, value in content.items() if isinstance(value, torch.Tensor)}
    if not tensors and len(inside) == 1:
        return next(iter(inside.values()))
    if all(key.startswith("module.") for key in tensors):
        return {key.removeprefix("module."): value for key, value in tensors.items()}
    return tensors


def _without_prefix(state: dict[str, torch.Tensor], wanted: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The state without what a wrapper (Lightning's "model.", "_orig_mod." of torch.compile) put before all keys, where
    only so they are the network's."""
    shorter = state
    while shorter and not any(key in wanted for key in shorter):
        first = {key.partition(".")[0] for key in shorter}
        if len(first) > 1 or not all("." in key for key in shorter):
            return state
        shorter = {key.partition(".")[2]: value for key, value in shorter.items()}
    return shorter


def _first(names: Sequence[Any]) -> str:
    shown = ", ".join(str(name) for name in names[:_SHOWN])
    return f"{shown}, ..." if len(names) > _SHOWN else shown
