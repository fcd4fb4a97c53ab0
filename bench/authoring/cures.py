"""What to do about an exception that a plugin raised: the mistakes that authors of networks make again and again."""

from __future__ import annotations

import re
import traceback
from dataclasses import fields

from bench.errors import did_you_mean
from bench.registry import PluginConfig

_NO_WEIGHTS = (
    "give the file, stereo.weights=FILE: a config that derives from NetworkConfig has that setting, and "
    "self.weights_path is None without it"
)
_CURES = (
    (
        r"not compiled with CUDA|No CUDA GPUs|no NVIDIA driver|NVIDIA driver on your system|requires CUDA",
        "this machine has no CUDA: leave out .cuda() and device='cuda'; TorchStereo moves what load() returns to the "
        "device that the run has, self.device, and others write .to(self.device)",
    ),
    (
        r"deserialize object on a CUDA device",
        "read the file for the CPU: bench.stereo.checkpoint.load_state(path), or torch.load(path, map_location='cpu', "
        "weights_only=True)",
    ),
    (
        r"tensors to be on the same device|should be the same|convert cuda:\d+ device type tensor to numpy",
        "tensors on two devices: make new ones on that of the input, device=left.device, and end with .cpu().numpy()",
    ),
    (r"requires grad\. Use tensor\.detach", "compute in torch.inference_mode(), or return result.detach().numpy()"),
    (
        r"Error\(s\) in loading state_dict",
        "bench.stereo.checkpoint: load_state(path) takes the tensors out of what training scripts put around them, and "
        "fit_state(network, state, path) says which keys differ",
    ),
    (
        r"Sizes of tensors must match|The size of tensor a",
        "sides that can't be halved so often: write pad_multiple = 32 (or 64) in the class; without TorchStereo pad "
        "the images to such a multiple and cut the answer to their size",
    ),
    (r"FileNotFoundError.*\.(pth|pt|ckpt|tar|bin|onnx|npz|safetensors|pkl)\b", _NO_WEIGHTS),
    (r"'NoneType' object has no attribute '(read|seek|tell)'|torch\.load from a file that is seekable", _NO_WEIGHTS),
    (r"NoneType.*(PathLike|os\.fspath|str, bytes)|(PathLike|str, bytes).*NoneType", _NO_WEIGHTS),
)


def cure_of(error: Exception) -> str:
    """How to mend what the exception says, where that is known; else an empty string."""
    if isinstance(error, AttributeError) and isinstance(error.obj, PluginConfig):
        names = [field.name for field in fields(error.obj) if field.name != "name"]
        near = did_you_mean(error.name or "", names)
        return f"{type(error.obj).__name__} has {', '.join(names) or 'no settings'}.{near}"
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, AssertionError) and frames and "weights" in (frames[-1].line or ""):
        return _NO_WEIGHTS
    said = " ".join(f"{type(error).__name__}: {error}".split())
    return next((cure for pattern, cure in _CURES if re.search(pattern, said)), "")
