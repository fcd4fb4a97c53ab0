"""Files of ``torch.save`` that others wrote: tensors and plain data, read without running code in them."""

from __future__ import annotations

import tarfile
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.io.foreign import open_plain

MOST_BYTES = 20e9
"""Checkpoints with an optimizer's state have a few GB."""


def load_tensors(path: Path) -> Any:
    """What a file of ``torch.save`` holds, on the CPU; nothing but tensors and plain data is unpickled.

    Raises ``BenchError`` for what is no plain file, and whatever torch makes of a damaged file, or of one that would
    run code (``pickle.UnpicklingError``).
    """
    import torch  # it takes a while to load, and few commands need it

    with open_plain(path, MOST_BYTES) as file:
        if tarfile.is_tarfile(file):
            # torch's reader of its oldest format would unpack it.
            raise ValueError("it is a tar archive")
        file.seek(0)
        if zipfile.is_zipfile(file):
            _require_stored(file.seek(0, 2), zipfile.ZipFile(file))
    with warnings.catch_warnings():
        # About layouts that torch means to change; nothing that its reader can act on.
        warnings.simplefilter("ignore")
        return torch.load(path, map_location="cpu", weights_only=True)


def to_state(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same with numpy arrays as tensors of their own, for a ``state()``; what is no array stays."""
    import torch

    arrays = (np.ndarray, np.generic)
    return {k: torch.from_numpy(_signed(np.array(v))) if isinstance(v, arrays) else v for k, v in values.items()}


def from_state(values: Mapping[str, Any]) -> dict[str, Any]:
    """What ``to_state`` was given, but for uint64, which comes back as int64 with the same bits."""
    import torch

    return {key: value.numpy() if isinstance(value, torch.Tensor) else value for key, value in values.items()}


def _signed(array: Any) -> Any:
    """Tensors of uint64 can do too little."""
    return array.view(np.int64) if array.dtype == np.uint64 else array


def _require_stored(size: int, archive: zipfile.ZipFile) -> None:
    """torch stores its parts as they are; packed ones could be of any size when they are unpacked."""
    unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > size:
        raise ValueError(f"its parts would take {unpacked / 1e9:,.1f} GB, and the file has {size / 1e9:,.1f} GB")
