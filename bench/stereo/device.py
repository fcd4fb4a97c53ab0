"""Which device and number format a network runs in."""

from __future__ import annotations

import torch

from bench.errors import BenchError, require_choice

DTYPES = ("float32", "bfloat16", "float16")


def choose_device(setting: str, where: str = "stereo.device") -> torch.device:
    """The device for "auto" (CUDA where there is one), "cpu", "cuda" or "cuda:1"; raises ``BenchError``, calling
    the setting ``where``."""
    cuda = torch.cuda.is_available()
    if setting == "auto":
        return torch.device("cuda" if cuda else "cpu")
    kind, _, number = setting.partition(":")
    require_choice(where, kind, ("auto", "cpu", "cuda"))
    if kind == "cuda" and not cuda:
        raise BenchError(f"{where}={setting}: torch finds no CUDA device here. Use {where}=cpu or auto.")
    if number and not (kind == "cuda" and number.isdigit() and int(number) < torch.cuda.device_count()):
        count = torch.cuda.device_count()
        raise BenchError(f"{where}={setting}: there are {count} CUDA devices here, counted from cuda:0.")
    return torch.device(setting)


def choose_dtype(setting: str) -> torch.dtype:
    """The number format by its name; raises ``BenchError`` for one that is not float32, bfloat16 or float16."""
    dtype: torch.dtype = getattr(torch, require_choice("stereo.dtype", setting, DTYPES))
    return dtype
