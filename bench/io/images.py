"""Image files of a sequence: what their headers say, and decoding them to RGB."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.io.foreign import open_plain, read_plain, reading
from bench.types import Image

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")

_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"
_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
# Start-of-frame markers of JPEG, which carry the size (C4, C8 and CC have other meanings).
_JPEG_SIZE_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Encoders may pad a file behind its end marker, so the marker is looked for in the last bytes.
_TAIL_BYTES = 64
_FULL_BITS = 16
# Bits of the cameras that write 16-bit files; 8 is that of files converted from 8 bits.
_CAMERA_BITS = (8, 10, 12, 14)
_DECODED_AT_ONCE = 32


def describe_files(files: Sequence[Path]) -> str:
    """What a folder holds in place of the images looked for, for example ``"5 .tif, 1 .txt, the first a.tif"``."""
    counts = Counter(file.suffix or "without extension" for file in files)
    shown = ", ".join(f"{count} {suffix}" for suffix, count in counts.most_common(4))
    return f"{shown}, the first {min(file.name for file in files)}" if shown else "no file"


_MOST_PIXELS = 200_000_000
"""Of no camera; decoding takes a few bytes for each."""
_MOST_BYTES = 1e9


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels of a PNG or JPEG file, from its header, without decoding.

    Raises ``BenchError`` if the file is missing, is no such image, or is cut off before its end marker.
    """
    try:
        with open_plain(path, _MOST_BYTES) as file:
            start = file.read(32)
            size = _png_size(path, start) if start.startswith(_PNG_START) else None
            if size is None and start.startswith(_JPEG_START):
                size = _jpeg_size(path, file)
            file.seek(max(0, os.fstat(file.fileno()).st_size - _TAIL_BYTES))
            tail = file.read()
    except FileNotFoundError:
        raise BenchError(f"The image {path} is missing. Restore it, or choose a range without it.") from None
    except OSError as error:
        raise BenchError(f"The image {path} can't be read: {error.strerror}. Check the file's permissions.") from None
    if size is None:
        raise BenchError(f"{path} is not a PNG or JPEG image. Replace it by one.")
    if (_PNG_END if start.startswith(_PNG_START) else _JPEG_END) not in tail:
        raise BenchError(f"The image {path} is truncated (its end marker is absent). Copy or download it again.")
    if not 0 < size[0] * size[1] <= _MOST_PIXELS:
        raise BenchError(f"The image {path} says that it is {size[0]}x{size[1]} pixels. Copy or download it again.")
    return size


def _png_size(path: Path, start: bytes) -> tuple[int, int]:
    if len(start) < 24 or start[12:16] != b"IHDR":
        raise BenchError(f"The image {path} is truncated (its PNG header is incomplete). Copy or download it again.")
    return int.from_bytes(start[16:20], "big"), int.from_bytes(start[20:24], "big")


def _jpeg_size(path: Path, file: BinaryIO) -> tuple[int, int]:
    file.seek(2)
    while True:
        marker = file.read(2)
        while marker == b"\xff\xff":
            marker = marker[1:] + file.read(1)
        length = file.read(2)
        if len(marker) < 2 or len(length) < 2 or marker[0] != 0xFF:
            raise BenchError(f"The image {path} is truncated (its JPEG header is incomplete). Copy it again.")
        if marker[1] in _JPEG_SIZE_MARKERS:
            body = file.read(5)
            return int.from_bytes(body[3:5], "big"), int.from_bytes(body[1:3], "big")
        file.seek(int.from_bytes(length, "big") - 2, os.SEEK_CUR)


def require_one_size(paths: Iterable[Path]) -> tuple[int, int]:
    """Width and height shared by all the images; ``BenchError`` names the first image that differs or is damaged."""
    first: tuple[Path, tuple[int, int]] | None = None
    for path in paths:
        size = image_size(path)
        if first is None:
            first = (path, size)
        elif size != first[1]:
            raise BenchError(
                f"The image {path} is {size[0]}x{size[1]} pixels, but {first[0]} is {first[1][0]}x{first[1][1]}. "
                "All images of a sequence need one size: replace it, or choose a range without it."
            )
    if first is None:
        raise BenchError("No image was given; choose a range that holds at least one frame.")
    return first[1]


class ImageSequence:
    """The images of a sequence: one ``size`` (width, height), and one scale from what is stored to 8 bits.

    ``remarks`` says what a user should know of that scale.
    """

    def __init__(self, paths: Sequence[Path], whole: Sequence[Path]) -> None:
        """Check the headers of ``paths``; ``whole`` is the sequence that they are part of, which has the same scale.

        ``BenchError`` names the first image that is damaged or of another size than the first.
        """
        self.size = require_one_size(paths)
        self._bits, self.remarks = bits_in_use(whole) if any(map(_is_16_bit, paths)) else (_FULL_BITS, ())

    def read(self, path: Path) -> Image:
        """Decode an image of the sequence, as ``read_rgb``."""
        return read_rgb(path, self.size, self._bits)


def _is_16_bit(path: Path) -> bool:
    with path.open("rb") as file:
        start = file.read(25)
    return start.startswith(_PNG_START) and start[24] == _FULL_BITS


def bits_in_use(paths: Sequence[Path]) -> tuple[int, tuple[str, ...]]:
    """Bits that hold the values of the 16-bit PNGs among these images, and a remark where those are fewer than 16.

    As a file says (sBIT), else the fewest of a camera that hold the largest value.
    """
    paths, largest = [path for path in paths if _is_16_bit(path)], 0
    if not paths:
        return _FULL_BITS, ()
    with ThreadPoolExecutor() as pool:
        for at in range(0, len(paths), _DECODED_AT_ONCE):
            largest = max(largest, *pool.map(_largest_value, paths[at : at + _DECODED_AT_ONCE]))
            if largest >= 1 << _CAMERA_BITS[-1]:
                return _FULL_BITS, ()
    said = max(map(_significant_bits, paths))
    # By PNG's rules samples fill all 16 bits whatever sBIT says; many writers leave them in the low ones.
    candidates = (said,) if said and largest < 1 << said else _CAMERA_BITS
    bits = next((bits for bits in candidates if 0 < largest < 1 << bits), _FULL_BITS)
    if bits == _FULL_BITS:
        return bits, ()
    return bits, (
        f"the 16-bit images in {paths[0].parent.name} use {bits} bits (largest value {largest}): all are read as "
        f"{bits}-bit ones, value / {1 << bits - 8}",
    )


def _as_stored() -> int:
    """EXIF's turn of a picture is for people who look at it: the calibration is of the pixels as they are stored."""
    return int(cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)


def _largest_value(path: Path) -> int:
    stored = cv2.imdecode(np.fromfile(path, dtype=np.uint8), _as_stored() | cv2.IMREAD_ANYDEPTH)
    # A damaged image is told when its frame is read.
    return 0 if stored is None else int(stored.max())


def _significant_bits(path: Path) -> int:
    """The largest number in a PNG's sBIT chunk, which comes before its pixels; 0 where there is none."""
    with path.open("rb") as file:
        file.seek(len(_PNG_START))
        while len(head := file.read(8)) == 8 and head[4:] not in (b"IDAT", b"PLTE"):
            length = int.from_bytes(head[:4], "big")
            if head[4:] == b"sBIT":
                return max(file.read(length), default=0)
            file.seek(length + 4, os.SEEK_CUR)
    return 0


def read_rgb(path: Path, size: tuple[int, int], bits: int = _FULL_BITS) -> Image:
    """Decode an image to RGB uint8 (H, W, 3) as it is stored; a grey image becomes three equal channels.

    ``size`` is the (width, height) that the sequence promises; of a 16-bit PNG the upper 8 of its low ``bits`` count.
    Alpha is left out, EXIF's orientation is not applied. Raises ``BenchError`` on damage and on another size.
    """
    image_size(path)
    flags = _as_stored() if bits == _FULL_BITS else _as_stored() | cv2.IMREAD_ANYDEPTH
    with reading(path, "can't be read as an image", "Copy or download it again."):
        # File bytes are read here and not by OpenCV, which prints its own warnings about files that it can't open.
        image = cv2.imdecode(np.frombuffer(read_plain(path, _MOST_BYTES), np.uint8), flags)
    if image is None:
        raise BenchError(f"The image {path} is damaged and can't be decoded. Copy or download it again.")
    if (image.shape[1], image.shape[0]) != size:
        raise BenchError(
            f"The image {path} is {image.shape[1]}x{image.shape[0]} pixels; expected {size[0]}x{size[1]}. Replace it."
        )
    if image.dtype == np.uint16:
        image = image.astype(np.uint16) >> (bits - 8)
    return np.asarray(image, dtype=np.uint8)


def decode_png(content: bytes, size: tuple[int, int]) -> npt.NDArray[Any] | None:
    """The stored values (H, W) or (H, W, C), of 8 or 16 bits, blue first, of a PNG of this ``size`` (width, height).

    None for anything else; the size is that of the header, before anything is unpacked.
    """
    header = content[:8] == _PNG_START and tuple(int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if header == size else None


def read_16_bit(path: Path, size: tuple[int, int], what: str) -> npt.NDArray[np.uint16]:
    """The stored values (H, W) of a 16-bit PNG of one channel; raises ``BenchError`` for anything else, and another
    ``size`` (width, height). ``what`` is such a file: "KITTI stores disparities"."""
    with reading(path, "can't be read as an image", "Copy or unpack it again."):
        stored = decode_png(read_plain(path, _MOST_BYTES), size)
    if stored is None or stored.dtype != np.uint16 or stored.shape != size[::-1]:
        raise BenchError(f"{path} is no 16-bit PNG of {size[0]}x{size[1]} pixels, as {what}. Unpack it again.")
    return np.asarray(stored, np.uint16)


def shrunk(image: Image, size: tuple[int, int]) -> Image:
    """The image (H, W, 3) at ``size`` (width, height), by the mean over areas; of this size already, itself."""
    if (image.shape[1], image.shape[0]) == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def nearest_pixels(values: npt.NDArray[Any], size: tuple[int, int]) -> npt.NDArray[Any]:
    """Of an array (H, W), such as depth or classes, which must not be mixed: the nearest values at ``size`` (width,
    height); of this size already, itself."""
    if (values.shape[1], values.shape[0]) == size:
        return values
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST_EXACT), values.dtype)


def grey(image: Image) -> Image:
    """(H, W) uint8 luma of an RGB image (H, W, 3); a grey image passes through."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
