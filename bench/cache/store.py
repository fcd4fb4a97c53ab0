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
# The size is checked when so much of the limit was written since the last look. What is left of other sequences is then
# brought below the second.
_CHECK_EACH = 0.05
_TRIM_TO = 0.9
# Characters of a key that say which sequence and plugin it is of: the folder that the entry lies in.
SEQUENCE_KEY = 12
# The clock of a file system may lag behind.
_CLOCK_S = 0.05
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

    @property
    def sequence(self) -> Path:
        """Where the entries of the same sequence lie, by the same plugin with the same settings."""
        return self.path.parent


class CacheStore:
    """Reads and writes entries. ``limit`` is in bytes; it may be passed by a twentieth per process that writes.

    Every run reads its sequence from the first frame to the last, so what was used last is what is needed last. Where
    one sequence is larger than the limit, its first part stays and the rest is computed each time; removing what was
    not used for the longest time would remove each entry just before it is needed.
    """

    def __init__(self, folder: Path, limit: float) -> None:
        self.folder = folder
        _warn_of_others(folder)
        self._limit = limit
        # What other processes left there is not known yet, so the first entry written makes it look.
        self._unchecked = limit
        self._began = time.time() - _CLOCK_S
        self._full = False

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
        """Put the entry there, whole or not at all; old ones go when the limit is passed, and where only those of this
        run's sequence are left nothing more is kept. ``OSError``, ``BenchError`` when the folder can't be written."""
        self.write_content(kind, plugin, key, encode(stored))

    def write_content(self, kind: Kind, plugin: str, key: str, content: bytes) -> None:
        """As ``write``, for bytes of another format."""
        if self._full:
            return
        path = self._path(kind, plugin, key)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            temporary.write_bytes(content)
        self._unchecked += len(content)
        if self._unchecked >= _CHECK_EACH * self._limit:
            self.trim()

    def lock(self, key: str) -> AbstractContextManager[None]:
        """For the process that computes this entry. One of 256 lock files by the key's last digits: their number stays
        bounded, and two keys seldom meet. ``OSError`` when the folder can't be written or knows no locks."""
        return self._lock(key[-2:])

    def trim(self) -> None:
        """Bring the size below the limit: what is left of sequences that no run reads now goes first, oldest first;
        then, of those that are read now, what this run has not come to yet, and at last the newest of what it has."""
        with self._lock("trim"):
            entries = list(self.files())
            total = sum(file.size for file in entries)
            if total > self._limit:
                read_now = {file.sequence for file in entries if file.used >= self._began}
                left = [file for file in entries if file.sequence not in read_now]
                own = [file for file in entries if file.sequence in read_now]
                total -= _remove(sorted(left, key=lambda file: file.used), total - _TRIM_TO * self._limit)
                # Newest first of each: what has just been used is needed again last.
                own.sort(key=lambda file: (file.used >= self._began, -file.used))
                waiting = sum(file.size for file in own if file.used < self._began)
                self._full = total - waiting > self._limit
                total -= _remove(own, total - self._limit)
                log.info("cache: brought down to %.2f GB", total / 1e9)
                if self._full:
                    log.warning(
                        "cache: this sequence is larger than cache.limit_gb=%g: %s keeps the first part of it, and the "
                        "rest is computed each time. A larger limit keeps all.",
                        self._limit / 1e9,
                        self.folder,
                    )
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
        return self.folder / kind / re.sub(r"[^\w-]", "_", plugin) / key[:SEQUENCE_KEY] / f"{key}{_SUFFIX}"

    def _lock(self, name: str) -> AbstractContextManager[None]:
        (self.folder / _LOCKS).mkdir(parents=True, exist_ok=True)
        return exclusive(self.folder / _LOCKS / name)


def _remove(files: list[File], excess: float) -> int:
    """Remove files in this order until so many bytes are gone, or all of them; returns how many bytes went."""
    removed = 0
    for file in files:
        if removed >= excess:
            break
        file.path.unlink(missing_ok=True)
        removed += file.size
    return removed


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
