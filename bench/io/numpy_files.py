"""``.npy`` and ``.npz`` files that others wrote: their headers say what they hold before any of it is read."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from bench.io.foreign import open_plain

_MOST_MEMBERS = 10_000


@dataclass(frozen=True)
class ArrayHeader:
    """Shape and type of an array of numbers, as its file says; ``size`` in bytes."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def size(self) -> int:
        """Bytes of the array."""
        return math.prod(self.shape) * self.dtype.itemsize


def npy_header(path: Path, most: float) -> ArrayHeader:
    """The header of a ``.npy`` file of at most ``most`` bytes.

    Raises ``BenchError`` for what is no plain file or is larger, ``OSError`` for one that is missing, and some other
    exception for a damaged file, for pickled objects, and for one that is shorter than it says.
    """
    with open_plain(path, most) as file:
        header = _header(file)
        left = file.seek(0, 2) - _end_of_header(file)
        if header.size > left:
            raise ValueError(f"it says that it holds an array of shape {header.shape}, and ends after {left} bytes")
    return header


def read_npy(path: Path, most: float) -> npt.NDArray[Any]:
    """The array of a ``.npy`` file; raises as ``npy_header``."""
    npy_header(path, most)
    with open_plain(path, most) as file:
        return np.asarray(np.load(file, allow_pickle=False))


def npz_headers(path: Path, most: float) -> dict[str, ArrayHeader]:
    """The header of each array of numbers in a ``.npz`` file, by its name; nothing else is unpacked.

    Raises as ``npy_header``.
    """
    with open_plain(path, most) as file, zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        if len(members) > _MOST_MEMBERS:
            raise ValueError(f"it has {len(members)} members")
        found = {}
        for member in members:
            if member.filename.endswith(".npy"):
                with archive.open(member) as content:
                    header = _header(content)
                if header.size > member.file_size:
                    raise ValueError(f"its array {member.filename} is shorter than its header says")
                found[member.filename.removesuffix(".npy")] = header
        return found


def read_npz(path: Path, names: Mapping[str, ArrayHeader], most: float) -> dict[str, npt.NDArray[Any]]:
    """The arrays of these names and headers (of ``npz_headers``); together at most ``most`` bytes unpacked."""
    total = sum(header.size for header in names.values())
    if total > most:
        raise ValueError(f"its arrays {', '.join(names)} would take {total / 1e9:,.1f} GB")
    with open_plain(path, math.inf) as file, np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in names}


def _header(file: IO[bytes]) -> ArrayHeader:
    version = np.lib.format.read_magic(file)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"it is of version {version} of the format")
    shape, _, dtype = readers[version](file)
    if dtype.hasobject:
        raise ValueError("it holds pickled objects")
    if any(length < 0 for length in shape):
        raise ValueError(f"it says that its array has the shape {shape}")
    return ArrayHeader(shape, dtype)


def _end_of_header(file: IO[bytes]) -> int:
    file.seek(0)
    _header(file)
    return file.tell()
