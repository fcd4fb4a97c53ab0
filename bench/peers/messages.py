"""Messages between the bench and a peer process: a JSON header and raw arrays, so that reading one can't run code.

On the wire: the four bytes ``BGSP``, the header's length (uint32, little endian), the header (UTF-8 JSON: ``kind``,
``fields``, and name, dtype and shape of each array), then the arrays' bytes in that order, C-contiguous.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

_MAGIC = b"BGSP"
_PREFIX = struct.Struct("<4sI")
_DTYPES = ("uint8", "int64", "float64")
_MAX_HEADER_BYTES = 1 << 20
_MAX_ARRAY_BYTES = 1 << 28

Array = npt.NDArray[Any]


class MalformedMessageError(Exception):
    """What came is no message; the text says why."""


@dataclass(frozen=True)
class Message:
    """``kind`` says what is asked or answered; ``fields`` hold plain JSON values, ``arrays`` uint8, int64 or float64
    of any shape."""

    kind: str
    fields: dict[str, Any] = field(default_factory=dict)
    arrays: dict[str, Array] = field(default_factory=dict)


def encode(message: Message) -> list[bytes | memoryview]:
    """The message as pieces to write one after the other; the arrays are not copied if they are contiguous."""
    arrays = {name: np.ascontiguousarray(array) for name, array in message.arrays.items()}
    for name, array in arrays.items():
        if array.dtype.name not in _DTYPES:
            raise TypeError(f"array '{name}' is {array.dtype.name}; a message carries {', '.join(_DTYPES)}")
    listed = [[name, array.dtype.name, list(array.shape)] for name, array in arrays.items()]
    header = json.dumps({"kind": message.kind, "fields": message.fields, "arrays": listed}).encode()
    # A memoryview of an empty array can't be cast to bytes.
    bodies = [array.data.cast("B") for array in arrays.values() if array.size]
    return [_PREFIX.pack(_MAGIC, len(header)) + header, *bodies]


def read_message(read: Callable[[int], bytes | bytearray]) -> Message:
    """Read one message; ``read(n)`` gives exactly n bytes. Raises ``MalformedMessageError`` for anything else."""
    magic, length = _PREFIX.unpack(read(_PREFIX.size))
    if magic != _MAGIC or length > _MAX_HEADER_BYTES:
        raise MalformedMessageError(f"it begins with {magic!r}")
    try:
        header = json.loads(bytes(read(length)).decode())
        kind, fields, listed = header["kind"], header["fields"], header["arrays"]
        specs = [(str(name), str(dtype), tuple(int(n) for n in shape)) for name, dtype, shape in listed]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise MalformedMessageError(f"its header can't be read ({type(error).__name__})") from error
    if not isinstance(kind, str) or not isinstance(fields, dict):
        raise MalformedMessageError("its header has no kind or no fields")
    return Message(kind, fields, {name: _read_array(read, name, dtype, shape) for name, dtype, shape in specs})


def _read_array(read: Callable[[int], bytes | bytearray], name: str, dtype: str, shape: tuple[int, ...]) -> Array:
    if dtype not in _DTYPES or any(n < 0 for n in shape):
        raise MalformedMessageError(f"its array '{name}' is {dtype} of shape {shape}")
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size > _MAX_ARRAY_BYTES:
        raise MalformedMessageError(f"its array '{name}' of shape {shape} is too large")
    return np.frombuffer(read(size), dtype=dtype).reshape(shape)
