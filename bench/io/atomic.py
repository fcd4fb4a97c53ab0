"""Files that are written whole or not at all: write beside the target, then rename."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from bench.errors import BenchError

# How the temporary files of an interrupted writer look; a run folder removes them when it is opened again.
TEMPORARY_PATTERN = ".writing-*"

_counter = itertools.count()


@contextmanager
def atomic_path(final: Path) -> Iterator[Path]:
    """Give a temporary path in the folder of ``final``; on success it is flushed to disk and renamed to ``final``.

    The temporary name ends like ``final`` (writers that go by the extension work). If the body raises, also on
    Ctrl-C, the temporary file is removed and an older ``final`` stays as it was. Raises ``BenchError`` when the
    folder can't be written.
    """
    final = Path(final)
    temporary = final.with_name(f".writing-{os.getpid()}-{next(_counter)}-{final.name}")
    try:
        yield temporary
        with open(temporary, "rb+") as written:
            os.fsync(written.fileno())
        os.replace(temporary, final)
    except OSError as error:
        raise BenchError(
            f"Can't write {final}: {error.strerror or error}. Check the folder, its permissions and the free space."
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` atomically; raises ``BenchError`` when the file can't be written."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write UTF-8 text atomically; raises ``BenchError`` when the file can't be written."""
    write_bytes(path, content.encode())


def write_json(path: Path, content: Any) -> None:
    """Write JSON atomically; numbers that are NaN or infinite become null, numpy values and paths plain ones.

    Raises ``BenchError`` when the file can't be written, and ``TypeError`` for an object that JSON has no form for.
    """
    write_text(path, json.dumps(_plain(content), indent=2, allow_nan=False) + "\n")


def write_image(path: Path, image: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> None:
    """Write a PNG atomically: RGB uint8 (H, W, 3), or one channel uint8 or uint16 (H, W)."""
    stored = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    # Run-length PNG at level 1: on a KITTI frame faster and smaller than the default strategy at the same level.
    fast = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    done, encoded = cv2.imencode(".png", stored, fast)
    if not done:
        raise BenchError(
            f"Can't encode an image of shape {image.shape}, {image.dtype}, as {path}; PNG wants uint8 or uint16."
        )
    write_bytes(path, encoded.tobytes())


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
