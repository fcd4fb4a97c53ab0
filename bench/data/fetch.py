"""``bgs-bench data get``: download the archives of a data set, check them, unpack them below the data folder.

What was fetched stands in ``$BGS_DATA/fetched.json``: each archive's size and SHA-256 when it came first, which hold
for it from then on, and which sequences of it were unpacked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from bench.data.manifest import Archive, DataSet
from bench.errors import BenchError
from bench.io.archives import NoRoomError, unpack
from bench.io.atomic import write_json
from bench.io.file_lock import exclusive
from bench.io.foreign import reading
from bench.io.json_files import load_json
from bench.weights.download import Report, download

_RECORD = "fetched.json"
_DOWNLOADS = ".downloads"
_ALL = "*"
_SUM_LINE = re.compile(r"([0-9a-fA-F]{64}) [ *]?(\S.*)")


@dataclass
class Fetched:
    """What is known of an archive that was here: its sum, the sequences unpacked ("*": all), and a file that came."""

    sha256: str
    size: int
    url: str
    unpacked: list[str]
    witness: str

    @property
    def of_all(self) -> bool:
        """Whether all sequences in the archive were unpacked."""
        return _ALL in self.unpacked


@dataclass(frozen=True)
class FetchOptions:
    """How to fetch: a ``mirror``'s address ("" for the publisher's), sums by file name that the user knows, whether
    archives stay after they are unpacked, and the tries and seconds of a download."""

    mirror: str = ""
    sums: Mapping[str, str] = field(default_factory=dict)
    keep: bool = False
    tries: int = 5
    timeout_s: float = 30.0
    pause_s: float = 1.0


def address(archive: Archive, mirror: str) -> str:
    """Where the archive is fetched from; ``BenchError`` for a mirror that is no web address."""
    if not mirror:
        return archive.url
    if not mirror.startswith(("http://", "https://")):
        raise BenchError(f"The mirror {mirror} is no address: give http://... or https://..., the folder of the files.")
    return f"{mirror.rstrip('/')}/{archive.file}"


def read_sums(path: Path) -> dict[str, str]:
    """SHA-256 by file name of a file as ``sha256sum`` writes it; ``BenchError`` for another."""
    with reading(path, "can't be read", "Give a file with lines as sha256sum writes them."):
        lines = [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    found = [_SUM_LINE.fullmatch(line.strip()) for line in lines]
    if bad := [line for line, match in zip(lines, found, strict=True) if match is None]:
        raise BenchError(f"{path}: '{bad[0][:60]}' is no line as sha256sum writes them, 64 digits and a file's name.")
    return {PurePosixPath(match[2]).name: match[1].lower() for match in found if match is not None}


def is_here(root: Path, data: DataSet, archive: Archive, sequences: Sequence[str]) -> bool:
    """Whether these sequences of the archive (none given: all) were unpacked and lie there."""
    known = read_record(root).get(_key(data, archive))
    if known is None or not (root / data.folder / known.witness).is_file():
        return False
    return known.of_all or (bool(sequences) and set(sequences) <= set(known.unpacked))


def fetch(
    root: Path,
    data: DataSet,
    archive: Archive,
    sequences: Sequence[str],
    options: FetchOptions,
    report: Report | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Download and unpack one archive (of several sequences in it those asked for); ``say`` gets a line of what came.

    One process at a time; one that waited finds it here. Raises ``BenchError``; of a file that is not the right one
    nothing is left.
    """
    place = root / _DOWNLOADS / data.name / archive.file
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with exclusive(place.with_name(f".{place.name}.unpacking.lock")):
            if not is_here(root, data, archive, sequences):
                _fetch(root, data, archive, sequences, options, report, say)
    except OSError as error:
        raise BenchError(
            f"Can't write below {root}: {error.strerror or error}. Make room, or set $BGS_DATA to another folder."
        ) from error


def _fetch(
    root: Path,
    data: DataSet,
    archive: Archive,
    sequences: Sequence[str],
    options: FetchOptions,
    report: Report | None,
    say: Callable[[str], None],
) -> None:
    url = address(archive, options.mirror)
    place = root / _DOWNLOADS / data.name / archive.file
    sha256, whose = _expected(root, data, archive, options)
    try:
        got = download(
            *(url, place, sha256, report, options.tries, options.timeout_s, options.pause_s),
            size=archive.size,
            setting="$BGS_DATA",
        )
    except BenchError as error:
        raise BenchError(f"{error}{whose}" if "with SHA-256" in str(error) else str(error)) from error
    if not got.startswith(sha256):  # kept from an earlier time, when another sum was expected
        place.unlink()
        raise BenchError(f"{place} had SHA-256 {got} instead of {sha256} and was removed.{whose}")
    unverified = "   (not verified: its publisher tells no sum; recorded, and compared from now on)"
    say(f"{got}  {archive.file}{'' if sha256 else unverified}")
    try:
        files = _unpack(place, root / data.folder, archive, sequences)
        if not files:
            raise BenchError(f"{archive.file} holds nothing that belongs to {data.name}: it is not the expected file.")
    except NoRoomError:
        raise
    except BenchError:
        place.unlink(missing_ok=True)
        raise
    unpacked = list(sequences) if archive.sequence_in and sequences else [_ALL]
    _remember(root, _key(data, archive), Fetched(got, place.stat().st_size, url, unpacked, str(files[-1])))
    if not options.keep:
        place.unlink()
    say(f"{archive.file}: {len(files)} files in {root / data.folder}")


def _unpack(place: Path, folder: Path, archive: Archive, sequences: Sequence[str]) -> list[PurePosixPath]:
    files = unpack(place, folder, placing(archive, sequences))
    if not archive.inner:
        return files
    inside: list[PurePosixPath] = []
    for each in files:
        zipped = folder / each
        try:
            found = unpack(zipped, zipped.parent, placing(replace(archive, anchor=archive.inner, inner=""), ()))
        finally:
            zipped.unlink()
        inside += [each.parent / path for path in found]
    return inside


def _expected(root: Path, data: DataSet, archive: Archive, options: FetchOptions) -> tuple[str, str]:
    """The SHA-256 that the file must have ("": nobody knows), and who says so, as a sentence."""
    if archive.file in options.sums:
        return options.sums[archive.file], " The sum is that of --sums."
    if archive.sha256:
        return archive.sha256, " The sum is the publisher's."
    known = read_record(root).get(_key(data, archive))
    if known is None:
        return "", ""
    return known.sha256, (
        f" The sum is that of the file which came first, as {root / _RECORD} says; if you know that the publisher "
        "changed it, remove its entry there."
    )


def placing(archive: Archive, sequences: Sequence[str]) -> Callable[[PurePosixPath], PurePosixPath | None]:
    """For a path in the archive the one below the data set's folder; None where it is of no use, or not of these
    ``sequences`` (none given: all)."""
    anchor = re.compile(archive.anchor)

    def place(path: PurePosixPath) -> PurePosixPath | None:
        at = next((i for i, part in enumerate(path.parts) if anchor.fullmatch(part)), None)
        if at is None or path.name in archive.without or (archive.inner and path.suffix != ".zip"):
            return None
        if archive.sequence_in and sequences:
            of = re.search(archive.sequence_in, str(path))
            if of is not None and of[1] not in sequences:
                return None
        return PurePosixPath(archive.into, *path.parts[at:])

    return place


def _key(data: DataSet, archive: Archive) -> str:
    return f"{data.name}/{archive.file}"


def read_record(root: Path) -> dict[str, Fetched]:
    """What was fetched into the data folder, by data set and file; empty where nothing was."""
    path = root / _RECORD
    if not path.is_file():
        return {}
    with reading(path, "is damaged", "Remove it: the sums of files that came before are then no longer compared."):
        stored: Any = load_json(path)
        return {key: Fetched(**value) for key, value in stored.items()}


def _remember(root: Path, key: str, fetched: Fetched) -> None:
    """Add to the record; sequences that were unpacked before from the same file stay."""
    with exclusive(root / f".{_RECORD}.lock"):
        record = read_record(root)
        before = record.get(key)
        if before is not None and before.sha256 == fetched.sha256:
            fetched.unpacked = sorted({*before.unpacked, *fetched.unpacked})
        record[key] = fetched
        write_json(root / _RECORD, {key: asdict(one) for key, one in sorted(record.items())})
