"""Files that others made: opened only where they are plain files of a plausible size; what is wrong is one sentence."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from bench.errors import BenchError, first_line
from bench.io.text_files import decode

MOST_TEXT = 256_000_000
"""Bytes of a text file: a trajectory of a million poses, or metrics of a thousand runs, has less."""
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


@contextmanager
def reading(path: Path, says: str, cure: str) -> Iterator[None]:
    """Whatever the block raises becomes ``BenchError``: "PATH SAYS: REASON. CURE", as "a.csv is damaged: ...".

    Damage leads decoders to any exception (``struct.error``, ``RecursionError``, ``MemoryError`` ...), and to the user
    all of them mean the same. A ``BenchError`` passes.
    """
    try:
        yield
    except BenchError:
        raise
    except Exception as error:
        raise BenchError(f"{path} {says}: {first_line(error)}. {cure}") from error


def plain_size(path: Path, most: float) -> int:
    """Size in bytes of a plain file, or of the one that a link leads to; nothing is opened.

    Raises ``BenchError`` where it is anything else (reading a named pipe or a device may never end), or larger than
    ``most`` bytes; ``OSError`` where it is missing.
    """
    return _checked(path, os.stat(path), most)


@contextmanager
def open_plain(path: Path, most: float) -> Iterator[BinaryIO]:
    """The file, opened for reading; raises as ``plain_size``."""
    plain_size(path, most)
    # Should it have been exchanged for a pipe since: opening one without O_NONBLOCK waits for its writer.
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        _checked(path, os.fstat(file.fileno()), most)
        yield file


def read_plain(path: Path, most: float = MOST_TEXT) -> bytes:
    """The content of a plain file; raises as ``plain_size``."""
    with open_plain(path, most) as file:
        return file.read(int(most) + 1)


def read_plain_text(path: Path, most: float = MOST_TEXT) -> str:
    """The text of a plain file, with plain line breaks; raises as ``plain_size`` and ``bench.io.text_files.decode``."""
    return decode(read_plain(path, most), path).replace("\r\n", "\n").replace("\r", "\n")


def _checked(path: Path, state: os.stat_result, most: float) -> int:
    if not stat.S_ISREG(state.st_mode):
        kind = next((name for test, name in _KINDS if test(state.st_mode)), "something else")
        raise BenchError(f"{path} is {kind} and no plain file. Put the file itself there.")
    if state.st_size > most:
        raise BenchError(
            f"{path} has {state.st_size / 1e6:,.0f} MB; more than {most / 1e6:,.0f} MB are not plausible for such a "
            "file. Is it the right one?"
        )
    return state.st_size
