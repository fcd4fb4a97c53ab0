"""The scores of a run's frames so far, a line each, so that a scoring that was stopped or killed goes on after them."""

from __future__ import annotations

import errno
import json
import os
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from bench.errors import BenchError
from bench.io.atomic import write_bytes
from bench.io.foreign import open_plain

Line = tuple[int, Any, Any]
"""A frame's number, what tells its saved pictures from others, and its scores: plain data."""
_MOST = 2e9
"""Bytes: a line has about one thousand."""


def read_scores(path: Path, identity: str) -> dict[int, Line]:
    """The lines of ``path`` by frame number, where it holds scores of this ``identity``; none where it does not.

    A damaged line and what follows it are not taken.
    """
    if not path.is_file():
        return {}
    with open_plain(path, _MOST) as file:
        contents = _contents(file)
        return _by_number(contents) if next(contents, None) == identity else {}


class ScoresFile:
    """Lines of JSON, each behind its CRC-32, appended one by one; the first says what the scores depend on."""

    def __init__(self, path: Path, identity: str, lines: Iterable[Line]) -> None:
        """Write the file anew with these lines. Raises ``BenchError`` where that can't be done."""
        write_bytes(path, b"".join(_sealed(line) for line in (identity, *lines)))
        self._path = path
        # Unbuffered: a line is with the operating system, whatever becomes of this process.
        self._file = open(path, "ab+", buffering=0)  # noqa: SIM115 (closed by ``close``)

    def append(self, line: Line) -> None:
        """Add a line; ``BenchError`` where the disk is full."""
        sealed = _sealed(line)
        try:
            if self._file.write(sealed) != len(sealed):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise BenchError(
                f"Can't write {self._path}: {error.strerror or error}. Make room and score again: it goes on."
            ) from error

    def read(self) -> dict[int, Line]:
        """All lines by frame number: of this very file, should another process have put its own in that place."""
        self._file.seek(0)
        with open(
            self._file.fileno(), "rb", closefd=False
        ) as buffered:  # lines of an unbuffered file are read by bytes
            contents = _contents(buffered)
            next(contents)
            return _by_number(contents)

    def close(self) -> None:
        """Close the file; it stays."""
        self._file.close()


def pictures_of(paths: Iterable[Path]) -> list[list[int] | None]:
    """Size and time of the last change (ns) of each file, None where there is none: they tell when it was replaced."""
    found: list[list[int] | None] = []
    for path in paths:
        try:
            about = os.stat(path)
            found.append([about.st_size, about.st_mtime_ns])
        except FileNotFoundError:
            found.append(None)
    return found


def _contents(file: BinaryIO) -> Iterator[Any]:
    for sealed in file:
        checksum, _, content = sealed.partition(b" ")
        if checksum != _checksum(content) or not content.endswith(b"\n"):
            return
        yield json.loads(content)


def _by_number(contents: Iterable[Any]) -> dict[int, Line]:
    return {number: (number, pictures, scores) for number, pictures, scores in contents}


def _sealed(content: Any) -> bytes:
    line = json.dumps(content).encode() + b"\n"
    return _checksum(line) + b" " + line


def _checksum(line: bytes) -> bytes:
    return b"%08x" % zlib.crc32(line)
