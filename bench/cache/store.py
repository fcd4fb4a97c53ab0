"""The folder of the disk cache: entries by key, shared by any number of processes, kept below a size."""

from __future__ import annotations

import logging
import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bench.cache.entry import DamagedEntryError, Stored, decode, encode
from bench.errors import BenchError, first_line
from bench.io.atomic import TEMPORARY_PATTERN, atomic_path
from bench.io.file_lock import exclusive
from bench.io.foreign import read_plain

log = logging.getLogger(__name__)

Kind = Literal["stereo", "sky", "tracker"]
KINDS: tuple[Kind, ...] = ("stereo", "sky", "tracker")

_SUFFIX = ".entry"
_LOCKS = "locks"
# The size is checked when so much of the limit was written since the last look, and then brought below the second.
_CHECK_EACH = 0.05
_TRIM_TO = 0.9
_MOST_BYTES = 4e9
"""Of one entry: depth and confidence of 100 megapixels, or the poses of a million frames, take less."""
# A temporary file of a process that was killed; a living one writes for far less than this.
_ABANDONED_S = 3600.0


@dataclass(frozen=True)
class File:
    """One entry on disk: size in bytes, and when it was last used (seconds since 1970)."""

    path: Path
    size: int
    used: float


class CacheStore:
    """Reads and writes entries. ``limit`` is in bytes; it may be passed by a twentieth per process that writes."""

    def __init__(self, folder: Path, limit: float) -> None:
        self.folder = folder
        _warn_of_others(folder)
        self._limit = limit
        # What other processes left there is not known yet, so the first entry written makes it look.
        self._unchecked = limit

    def read(self, kind: Kind, plugin: str, key: str) -> Stored | None:
        """The entry, marked as just used, or None. A damaged one counts as missing, with a line in the log."""
        content = self.read_content(kind, plugin, key)
        if content is None:
            return None
        try:
            return decode(content)
        except DamagedEntryError as damage:
            log.warning("cache: %s is damaged (%s); computing it again", self._path(kind, plugin, key), damage)
            return None

    def read_content(self, kind: Kind, plugin: str, key: str) -> bytes | None:
        """The bytes of an entry, marked as just used, or None."""
        path = self._path(kind, plugin, key)
        try:
            content = read_plain(path, _MOST_BYTES)
        except FileNotFoundError:
            return None
        except (OSError, BenchError) as error:  # BenchError: a folder or a pipe in its place
            log.warning("cache: %s can't be read (%s); computing it again", path, first_line(error))
            return None
        try:
            os.utime(path)
        except OSError as error:  # removed by another process just now, or a cache that this user may only read
            log.debug("cache: %s can't be marked as used (%s)", path, error.strerror)
        return content

    def write(self, kind: Kind, plugin: str, key: str, stored: Stored) -> None:
        """Put the entry there, whole or not at all; old ones go when the limit is passed. ``OSError``, ``BenchError``
        when the folder can't be written."""
        self.write_content(kind, plugin, key, encode(stored))

    def write_content(self, kind: Kind, plugin: str, key: str, content: bytes) -> None:
        """As ``write``, for bytes of another format."""
        path = self._path(kind, plugin, key)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            temporary.write_bytes(content)
        self._unchecked += len(content)
        if self._unchecked >= _CHECK_EACH * self._limit:
            self.trim()

    def lock(self, key: str) -> AbstractContextManager[None]:
        """For the process that computes this entry. One of 256 lock files by the key's first digits: their number stays
        bounded, and two keys seldom meet. ``OSError`` when the folder can't be written or knows no locks."""
        return self._lock(key[:2])

    def trim(self) -> None:
        """Remove the entries that were not used for the longest time until the rest is well below the limit."""
        with self._lock("trim"):
            entries = sorted(self.files(), key=lambda file: file.used)
            total = sum(file.size for file in entries)
            if total > self._limit:
                for file in entries:
                    if total <= _TRIM_TO * self._limit:
                        break
                    file.path.unlink(missing_ok=True)
                    total -= file.size
                log.info("cache: brought down to %.2f GB", total / 1e9)
            self._remove_abandoned()
        self._unchecked = 0.0

    def files(self, kind: Kind | None = None) -> Iterator[File]:
        """Every entry there is, of one kind or of all."""
        for each in KINDS if kind is None else (kind,):
            for path in (self.folder / each).glob(f"*/*/*{_SUFFIX}"):
                try:
                    state = path.stat()
                except FileNotFoundError:
                    continue  # another process removed it meanwhile
                yield File(path, state.st_size, state.st_mtime)

    def clear(self, kind: Kind | None = None) -> tuple[int, int]:
        """Remove all entries, of one kind or of all, and nothing else; returns how many and how many bytes."""
        removed, size = 0, 0
        for file in self.files(kind):
            file.path.unlink(missing_ok=True)
            removed, size = removed + 1, size + file.size
        return removed, size

    def _remove_abandoned(self) -> None:
        for kind in KINDS:
            for path in (self.folder / kind).glob(f"*/*/{TEMPORARY_PATTERN}"):
                try:
                    abandoned = path.stat().st_mtime < time.time() - _ABANDONED_S
                except FileNotFoundError:
                    continue
                if abandoned:
                    path.unlink(missing_ok=True)

    def _path(self, kind: Kind, plugin: str, key: str) -> Path:
        return self.folder / kind / re.sub(r"[^\w-]", "_", plugin) / key[:2] / f"{key}{_SUFFIX}"

    def _lock(self, name: str) -> AbstractContextManager[None]:
        (self.folder / _LOCKS).mkdir(parents=True, exist_ok=True)
        return exclusive(self.folder / _LOCKS / name)


_looked_at: set[Path] = set()


def _warn_of_others(folder: Path) -> None:
    """Say once that others can write into the folder: an entry of theirs would be taken for an answer."""
    if folder in _looked_at:
        return
    _looked_at.add(folder)
    if others_can_write(folder):
        log.warning(
            "cache: other users can write into %s, and what they put there is taken for computed depth. "
            "`chmod go-w` it, or choose another with cache.folder.",
            folder,
        )


def others_can_write(folder: Path) -> bool:
    """Whether other users can write into a folder; False where there is none.

    A folder of this user's own group counts as theirs alone: many systems give every user a group of the same name and
    make its folders writable.
    """
    try:
        state = folder.stat()
    except OSError:
        return False
    of_group = bool(state.st_mode & stat.S_IWGRP) and state.st_gid != os.getgid()
    return of_group or bool(state.st_mode & stat.S_IWOTH) or state.st_uid not in (0, os.getuid())
