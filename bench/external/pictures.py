"""Colour and depth pictures of another system: checked before anything is written, then read one by one."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.errors import BenchError
from bench.io.foreign import plain_size, read_plain, reading
from bench.io.images import image_size
from bench.io.numpy_files import npy_header, read_npy
from bench.runs.folder import DEPTH_SCALE
from bench.types import Map

_PNG_START = b"\x89PNG\r\n\x1a\n"
_AS_AN_ARRAY = ("can't be read as a NumPy array", "Write it again with numpy.save.")
_CHUNK_FRAME = 12
"""Bytes of a PNG chunk besides its data: length, type, checksum."""

Size = tuple[int, int]
"""Width and height in pixels."""


class NotMetricError(BenchError):
    """Depth pictures that are no depth in metres, but pictures for people to look at."""


@dataclass(frozen=True)
class DepthFormat:
    """How depth is stored: ``scale`` divides the stored numbers to give metres; ``asked``: the user gave it."""

    scale: float | None
    asked: bool

    def scale_of(self, path: Path) -> float:
        """What to divide by: the user's scale, else 256 for PNG (as KITTI) and 1 for .npy."""
        if self.scale is not None:
            return self.scale
        return DEPTH_SCALE if path.suffix.lower() == ".png" else 1.0


def check_sizes(files: Sequence[Path], size: Size) -> None:
    """Check by their headers that all PNG and JPEG files are whole and of ``size``; ``BenchError`` names the first."""
    for file in files:
        if file.suffix.lower() == ".npy":
            _require_array(file, size)
            continue
        plain_size(file, _most_bytes(size))
        there = image_size(file)
        if there != size:
            raise BenchError(
                f"{file} is {there[0]}x{there[1]} pixels, the data set's images {size[0]}x{size[1]}. Render at the "
                "data set's size: scores of resized images could not be compared."
            )


def check_content(file: Path, content: bytes) -> None:
    """Check the checksums in a PNG file, which decoders don't all do; ``BenchError`` where one is wrong."""
    if file.suffix.lower() != ".png":
        return
    at = len(_PNG_START)
    while at + _CHUNK_FRAME <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        end = at + 8 + length
        if zlib.crc32(content[at + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            raise BenchError(f"{file} is damaged (a checksum in it is wrong). Write it again.")
        if content[at + 4 : at + 8] == b"IEND":
            return
        at = end + 4
    raise BenchError(f"{file} is damaged (it ends too early). Write it again.")


def check_depth_pictures(files: Sequence[Path]) -> None:
    """Check that depth PNGs have 16 bits and one channel; ``NotMetricError`` names the first that has not."""
    for file in files:
        if file.suffix.lower() != ".png":
            continue
        with file.open("rb") as opened:
            header = opened.read(26)
        bits, kind = header[24], header[25]
        if (bits, kind) != (16, 0):
            channels = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGBA"}.get(kind, "unknown")
            raise NotMetricError(
                f"{file} is an {bits}-bit {channels} picture, for looking at, and no depth in metres. Give 16-bit grey "
                "PNGs (--depth-scale), or .npy in metres."
            )


def read_depth(file: Path, size: Size, form: DepthFormat) -> Map:
    """Depth (H, W) float32 in metres, NaN where there is none (0, negative or not finite in the file).

    Raises ``BenchError`` for damage, another size, and arrays that are not of floating-point numbers.
    """
    if file.suffix.lower() == ".npy":
        with reading(file, *_AS_AN_ARRAY):
            stored = np.squeeze(read_npy(file, _most_bytes(size)))
    else:
        with reading(file, "can't be read as a picture", "Write it again."):
            decoded = cv2.imdecode(np.frombuffer(read_plain(file, _most_bytes(size)), np.uint8), cv2.IMREAD_UNCHANGED)
            if decoded is None:
                raise BenchError(f"{file} is damaged and can't be decoded. Write it again.")
        stored = np.asarray(decoded)
    _require_shape(file, stored.shape, size)
    metres = stored.astype(np.float32) / np.float32(form.scale_of(file))
    metres[~(np.isfinite(metres) & (metres > 0))] = np.nan
    return metres


def _most_bytes(size: Size) -> int:
    """A picture or array of ``size`` has no more: 16 bytes a pixel, and room for what stands beside them."""
    return 16 * size[0] * size[1] + 1_000_000


def _require_array(file: Path, size: Size) -> None:
    """Check by its header that a ``.npy`` file holds depth of ``size``."""
    with reading(file, *_AS_AN_ARRAY):
        header = npy_header(file, _most_bytes(size))
    if not np.issubdtype(header.dtype, np.floating):
        raise BenchError(f"{file} holds no floating-point numbers. Depth in .npy is float32, in metres.")
    _require_shape(file, tuple(side for side in header.shape if side != 1), size)


def _require_shape(file: Path, shape: tuple[int, ...], size: Size) -> None:
    if shape != (size[1], size[0]):
        raise BenchError(
            f"{file} has shape {shape}; the data set's images are {size[0]}x{size[1]}, so (H, W) is "
            f"({size[1]}, {size[0]})."
        )
