"""Named sets of numpy arrays on disk, each written once and never changed, read as memory maps.

A file holds a line that names the format, a line of JSON with key, type, shape and place of each array, the arrays, and
at its end the CRC-32 of all before.
"""

from __future__ import annotations

import json
import logging
import math
import mmap
import os
import re
import struct
import threading
import weakref
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError, first_line
from bench.io.atomic import TEMPORARY_PATTERN, atomic_path
from bench.io.foreign import open_plain

log = logging.getLogger(__name__)

_SUFFIX = ".arrays"
_FORMAT = b"bgs-arrays 1\n"
_ALIGNMENT = 64
_PIECE = 1 << 20
"""Bytes that are written, or read and checked, at a time: they stay in the processor's cache."""
_NUMBERS = "biufc"
"""Kinds of numpy types that are stored."""
_CHECKSUM = struct.Struct("<I")
_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,199}")


class DamagedError(BenchError):
    """A set of arrays that is missing, cut or changed: the message names its file and what is wrong with it."""


class ArrayStore:
    """The sets below ``folder``, which is made with the first of them. Several stores may share a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self._verified: set[str] = set()
        self._maps: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self._maps_lock = threading.Lock()  # one thread may read while another releases

    def put(self, name: str, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Write a set of arrays of numbers or bools, of any shapes; when this returns it is on disk.

        It is there as a whole or not at all. Raises ``BenchError`` for a name that exists or that is none of letters,
        digits, ``-``, ``_`` and ``.``, and when the folder can't be written or the disk is full.
        """
        path = self._path(name)
        for key, array in arrays.items():
            if array.dtype.kind not in _NUMBERS:
                raise BenchError(
                    f"Array {key!r} of {name!r} is of type {array.dtype}; only numbers and bools are stored."
                )
        if name in self:
            raise BenchError(f"{path} exists already, and sets of arrays are never changed. Choose another name.")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BenchError(f"Can't make {self.folder}: {error.strerror}. Check the permissions.") from error
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            checksum = 0
            for piece in _pieces(arrays):
                file.write(piece)
                checksum = zlib.crc32(piece, checksum)
            file.write(_CHECKSUM.pack(checksum))
        _flush_folder(self.folder)
        self._verified.add(name)

    def get(self, name: str) -> dict[str, npt.NDArray[Any]]:
        """The arrays of a set as read-only memory maps; checked as a whole when this store reads them first.

        Raises ``DamagedError`` for a set that is missing, cut or changed. The maps stay valid when the set is removed.
        """
        path = self._path(name)
        try:
            with open_plain(path, math.inf) as file:
                content, arrays = _mapped(file)
                if name not in self._verified:
                    _verify(file)
        except FileNotFoundError as error:
            raise DamagedError(f"{path} is missing. Start the run anew, or put the file back.") from error
        except Exception as error:  # damage leads to any
            self._verified.discard(name)
            why = first_line(error)
            raise DamagedError(f"{path} is damaged: {why}. Start the run anew, or put a whole copy there.") from error
        self._verified.add(name)
        with self._maps_lock:
            self._maps.add(content)
        return arrays

    def release(self) -> None:
        """What is mapped no longer counts as this process's memory until it is read again; the maps stay valid."""
        if hasattr(mmap, "MADV_DONTNEED"):
            with self._maps_lock:
                for content in self._maps:
                    content.madvise(mmap.MADV_DONTNEED)

    def names(self) -> list[str]:
        """Names of all sets, sorted."""
        return sorted(path.name.removesuffix(_SUFFIX) for path in self.folder.glob(f"[!.]*{_SUFFIX}"))

    def __contains__(self, name: str) -> bool:
        return self._path(name).exists()

    def bytes(self, name: str) -> int:
        """Size of a set's file; ``DamagedError`` where there is none."""
        try:
            return self._path(name).stat().st_size
        except OSError as error:
            raise DamagedError(f"{self._path(name)}: {error.strerror}. Start the run anew.") from error

    def remove(self, name: str) -> None:
        """Remove a set; none of that name is no error."""
        self._verified.discard(name)
        self._path(name).unlink(missing_ok=True)

    def discard(self, keep: Iterable[str]) -> None:
        """Remove all sets but those named, and what processes that were killed while writing left behind."""
        for name in set(self.names()).difference(keep):
            self.remove(name)
        for leftover in self.folder.glob(TEMPORARY_PATTERN):
            # This process removes its own; what is there is being written by another thread.
            if not leftover.name.startswith(f".writing-{os.getpid()}-"):
                leftover.unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove all sets."""
        self.discard(())

    def _path(self, name: str) -> Path:
        if not _NAME.fullmatch(name):
            raise BenchError(f"{name!r} can't name a set of arrays: use up to 200 letters, digits, '-', '_' and '.'.")
        return self.folder / f"{name}{_SUFFIX}"


def _pieces(arrays: Mapping[str, npt.NDArray[Any]]) -> Iterator[memoryview | bytes]:
    """The content of a file, without its checksum; no array is copied as a whole."""
    described, end = [], 0
    for key, array in arrays.items():
        start = _aligned(end)
        described.append({"key": key, "dtype": array.dtype.str, "shape": array.shape, "start": start})
        end = start + array.nbytes
    header = _FORMAT + json.dumps({"bytes": end, "arrays": described}).encode() + b"\n"
    yield header.ljust(_aligned(len(header)))
    end = 0
    for array in arrays.values():
        yield bytes(_aligned(end) - end)
        end = _aligned(end) + array.nbytes
        # Row by row where the rows lie apart, as in a view into a larger buffer.
        for part in (array,) if array.flags.c_contiguous or array.ndim < 2 else array:
            content = np.ascontiguousarray(part).reshape(-1).view(np.uint8).data
            for at in range(0, len(content), _PIECE):
                yield content[at : at + _PIECE]


def _aligned(end: int) -> int:
    return -(-end // _ALIGNMENT) * _ALIGNMENT


def _verify(file: BinaryIO) -> None:
    """Raise ``ValueError`` unless the file ends with the checksum of what is before. It is read, not mapped: what is
    mapped counts as this process's memory."""
    left = file.seek(0, os.SEEK_END) - _CHECKSUM.size
    file.seek(0)
    checksum, piece = 0, bytearray(_PIECE)
    while left > 0:
        got = file.readinto(memoryview(piece)[: min(left, _PIECE)])  # type: ignore[attr-defined]
        if not got:
            raise ValueError("it was cut while it was read")
        checksum = zlib.crc32(memoryview(piece)[:got], checksum)
        left -= got
    if file.read() != _CHECKSUM.pack(checksum):
        raise ValueError("its checksum is wrong")


def _mapped(file: BinaryIO) -> tuple[mmap.mmap, dict[str, npt.NDArray[Any]]]:
    file.seek(0)
    if file.readline(len(_FORMAT)) != _FORMAT:
        raise ValueError("it is no file of arrays of this version")
    header = json.loads(file.readline())
    first, size = _aligned(file.tell()), file.seek(0, os.SEEK_END)
    if first + header["bytes"] + _CHECKSUM.size != size:
        raise ValueError(f"it has {size} bytes, and should have {first + header['bytes'] + _CHECKSUM.size}")
    content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    arrays = {}
    for each in header["arrays"]:
        dtype, shape = np.dtype(each["dtype"]), tuple(each["shape"])
        if dtype.kind not in _NUMBERS:
            raise ValueError(f"its array {each['key']} is of type {dtype}")
        arrays[each["key"]] = np.frombuffer(content, dtype, math.prod(shape), first + each["start"]).reshape(shape)
    return content, arrays


def _flush_folder(folder: Path) -> None:
    """So that the names in it survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:  # some network file systems can't flush a folder; its files are flushed
        log.debug("%s can't be flushed (%s)", folder, error.strerror)
    finally:
        os.close(descriptor)
