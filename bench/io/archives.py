"""Archives that others made (zip, tar): their plain files one after the other, and unpacking that stays in a folder."""

from __future__ import annotations

import gzip
import lzma
import os
import shutil
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from bench.errors import BenchError, first_line

_MOST_TIMES_LARGER = 100
"""Unpacked over packed size: text reaches 20, and what reaches 1000 was made to fill disks."""
_ALWAYS_ALLOWED = 100_000_000
_MOST_FILES = 5_000_000
_ZEROS = bytes(512)
_DAMAGES = (
    *(tarfile.TarError, zipfile.BadZipFile, gzip.BadGzipFile, zlib.error, lzma.LZMAError, EOFError),
    RuntimeError,  # what zipfile raises for a member with a password, or packed by a method that it does not know
)


class NoRoomError(BenchError):
    """The archive may be whole, but its content does not fit."""


@dataclass(frozen=True)
class Member:
    """One entry of an archive, at the moment when it is its turn; ``size`` in bytes as the archive says."""

    name: str
    size: int
    is_folder: bool
    is_file: bool
    open: Callable[[], IO[bytes]]

    def path(self, archive: Path) -> PurePosixPath:
        """The name as a path; ``BenchError`` where it leads out of the archive's folder."""
        path = PurePosixPath(self.name)
        if path.is_absolute() or ".." in path.parts or "\\" in self.name or "\0" in self.name:
            raise BenchError(
                f"{archive.name} holds '{self.name}', which leads out of its folder; nothing was extracted."
            )
        return path

    def require_file(self, archive: Path) -> None:
        """Raise ``BenchError`` for a link, a device or a folder."""
        if not self.is_file:
            raise BenchError(f"{self.name} in {archive.name} is a link or no file; nothing was extracted.")


@contextmanager
def members(archive: Path) -> Iterator[Iterator[Member]]:
    """The entries of a zip or tar file (also compressed), in its order, each to be read in its turn.

    Raises ``BenchError`` from the block where the archive is damaged or cut.
    """
    try:
        if zipfile.is_zipfile(archive):
            with zipfile.ZipFile(archive) as bundle:
                yield (_of_zip(bundle, info) for info in bundle.infolist())
        else:
            with tarfile.open(archive) as tar:
                yield _all_of_tar(tar)
    except _DAMAGES as error:
        raise BenchError(f"{archive.name} is damaged ({first_line(error)}). Download it again.") from error


def _of_zip(bundle: zipfile.ZipFile, info: zipfile.ZipInfo) -> Member:
    # The upper half of the attributes is the Unix mode, of which the highest four bits are the kind; 0 where made
    # elsewhere, 0o100000 a plain file.
    kind = (info.external_attr >> 16) & 0o170000
    plain = not info.is_dir() and kind in (0, 0o100000)
    return Member(info.filename, info.file_size, info.is_dir(), plain, lambda: bundle.open(info))


def _all_of_tar(tar: tarfile.TarFile) -> Iterator[Member]:
    for info in tar:
        yield _of_tar(tar, info)
    assert tar.fileobj is not None
    while tar.fileobj.read(1 << 20):  # the checksum of what is compressed stands behind all of it
        pass


def _of_tar(tar: tarfile.TarFile, info: tarfile.TarInfo) -> Member:
    def content() -> IO[bytes]:
        opened = tar.extractfile(info)
        assert opened is not None
        return opened

    return Member(info.name, info.size, info.isdir(), info.isfile(), content)


def unpack(archive: Path, folder: Path, place: Callable[[PurePosixPath], PurePosixPath | None]) -> list[PurePosixPath]:
    """Write the archive's files below ``folder`` where ``place`` says (None: not wanted); their places, in order.

    All of them are unpacked beside first and then moved, so that a damaged archive leaves nothing. Raises
    ``BenchError`` for a damaged one, one that leads out of its folder or holds links, and one whose content is larger
    than plausible or than the free space.
    """
    staging = folder / f".unpacking-{archive.name}"
    shutil.rmtree(staging, ignore_errors=True)  # of a killed process
    budget = _Budget(archive, folder)
    try:
        placed = _unpack_all(archive, staging, place, budget)
        for path in placed:
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(staging / path, target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return placed


def _unpack_all(
    archive: Path, staging: Path, place: Callable[[PurePosixPath], PurePosixPath | None], budget: _Budget
) -> list[PurePosixPath]:
    placed: dict[PurePosixPath, None] = {}
    with members(archive) as entries:
        for member in entries:
            path = member.path(archive)
            if member.is_folder:
                continue
            wanted = place(path)
            if wanted is None:
                continue
            member.require_file(archive)
            budget.spend(member)
            target = staging / wanted
            target.parent.mkdir(parents=True, exist_ok=True)
            with member.open() as source, open(target, "wb") as file:
                shutil.copyfileobj(source, file, 1 << 20)
            placed[wanted] = None
    _require_end(archive)
    return list(placed)


def _require_end(archive: Path) -> None:
    """A plain tar file that was cut between two files looks whole but for the zeros at its end."""
    if zipfile.is_zipfile(archive) or not _is_plain_tar(archive):
        return
    with open(archive, "rb") as file:
        file.seek(-len(_ZEROS), os.SEEK_END)
        if file.read() != _ZEROS:
            raise BenchError(f"{archive.name} is damaged (its end is missing). Download it again.")


def _is_plain_tar(archive: Path) -> bool:
    try:
        tarfile.open(archive, "r:").close()
    except tarfile.TarError:
        return False
    return True


class _Budget:
    """How much an archive may still write: zip and tar readers never give more bytes of a member than it declares."""

    def __init__(self, archive: Path, folder: Path) -> None:
        self._archive, self._files = archive, 0
        self._plausible = _MOST_TIMES_LARGER * archive.stat().st_size + _ALWAYS_ALLOWED
        folder.mkdir(parents=True, exist_ok=True)
        self._free = shutil.disk_usage(folder).free

    def spend(self, member: Member) -> None:
        """Count a member; ``BenchError`` where it is too much."""
        self._files += 1
        self._plausible -= member.size
        self._free -= member.size
        if self._plausible < 0 or self._files > _MOST_FILES or member.size < 0:
            raise BenchError(
                f"{self._archive.name} holds far more than its size lets expect, at {member.name}; nothing of it was "
                "kept. Is it the published file?"
            )
        if self._free < 0:
            raise NoRoomError(
                f"{self._archive.name} needs more space than is free, at {member.name}; nothing of it was kept. Make "
                "room, or set $BGS_DATA to a folder that has it."
            )
