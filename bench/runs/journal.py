"""Lists that only grow, on disk: each item is written once, as a line of JSON."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from bench.io.foreign import open_plain

T = TypeVar("T")


class Journal:
    """A file of JSON lines that is only added to. What counts is what a mark of ``extend`` says: a killed writer may
    have left more. Floats come back to the bit."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lines = self._bytes = 0
        self._checksum = hashlib.sha256()

    def extend(self, items: Sequence[T], as_plain: Callable[[T], Any]) -> dict[str, Any]:
        """Write those of ``items`` that are not there yet, to disk; returns the mark of all of them.

        ``items`` is the whole list, whose first part has not changed since. Raises ``OSError``.
        """
        new = items[self._lines :]
        added = "".join(
            json.dumps(as_plain(item), default=lambda number: number.item()) + "\n" for item in new
        ).encode()
        with os.fdopen(os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+b") as file:
            file.truncate(self._bytes)  # a line that was cut when the disk was full
            file.seek(self._bytes)
            file.write(added)
            file.flush()
            os.fsync(file.fileno())
        self._lines, self._bytes = len(items), self._bytes + len(added)
        self._checksum.update(added)
        return {"lines": self._lines, "bytes": self._bytes, "sha256": self._checksum.hexdigest()}

    def read(self, mark: dict[str, Any]) -> list[Any]:
        """The items of a mark; what follows them in the file is forgotten. Raises ``OSError`` or ``ValueError`` where
        they are not what was written."""
        size, count = int(mark["bytes"]), int(mark["lines"])
        with open_plain(self._path, float("inf")) as file:
            content = file.read(size)
        checksum = hashlib.sha256(content)
        if checksum.hexdigest() != mark["sha256"]:
            raise ValueError(f"{self._path.name} is cut or changed")
        items = [json.loads(line) for line in content.splitlines()]
        if len(items) != count:
            raise ValueError(f"{self._path.name} has {len(items)} lines for {count}")
        self._lines, self._bytes, self._checksum = count, size, checksum
        return items
