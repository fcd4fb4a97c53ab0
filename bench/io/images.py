"""Image files of a sequence: what their headers say, and decoding them to RGB."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from bench.errors import BenchError
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


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels of a PNG or JPEG file, from its header, without decoding.

    Raises ``BenchError`` if the file is missing, is no such image, or is cut off before its end marker.
    """
    try:
        with path.open("rb") as file:
            start = file.read(32)
            size = _png_size(path, start) if start.startswith(_PNG_START) else None
            if size is None and start.startswith(_JPEG_START):
                size = _jpeg_size(path)
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
    return size


def _png_size(path: Path, start: bytes) -> tuple[int, int]:
    if len(start) < 24 or start[12:16] != b"IHDR":
        raise BenchError(f"The image {path} is truncated (its PNG header is incomplete). Copy or download it again.")
    return int.from_bytes(start[16:20], "big"), int.from_bytes(start[20:24], "big")


def _jpeg_size(path: Path) -> tuple[int, int]:
    with path.open("rb") as file:
        file.seek(2)
        while True:
            marker = file.read(2)
            while len(marker) == 2 and marker[0] == 0xFF and marker[1] == 0xFF:
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


def read_rgb(path: Path, size: tuple[int, int]) -> Image:
    """Decode an image to RGB uint8 (H, W, 3); a grey image becomes three equal channels.

    ``size`` is the (width, height) that the sequence promises. Raises ``BenchError`` on damage and on another size.
    """
    # File bytes are read here and not by OpenCV, which prints its own warnings about files that it can't open.
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise BenchError(f"The image {path} can't be read: {error.strerror}. Restore the file.") from None
    image = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB) if data.size else None
    if image is None:
        raise BenchError(f"The image {path} is damaged and can't be decoded. Copy or download it again.")
    if (image.shape[1], image.shape[0]) != size:
        raise BenchError(
            f"The image {path} is {image.shape[1]}x{image.shape[0]} pixels; expected {size[0]}x{size[1]}. Replace it."
        )
    return np.asarray(image, dtype=np.uint8)


def grey(image: Image) -> Image:
    """(H, W) uint8 luma of an RGB image (H, W, 3); a grey image passes through."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
