"""Blocks of a Markdown file that are made by code: between ``<!-- table: NAME -->`` and ``<!-- end -->``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bench.errors import BenchError, require_choice

_START = re.compile(r"<!-- table: (\S+) -->")
_END = "<!-- end -->"
MARKER = re.compile(r"<!-- (?:table: \S+|end) -->")


@dataclass(frozen=True)
class Block:
    """A block's text: made by ``make`` of ``files`` in the folder it is given, links relative to the second."""

    files: tuple[str, ...]
    make: Callable[[Path, Path], str]


@dataclass(frozen=True)
class Updated:
    """The new text, the names of the blocks that were stale, and what is lacking for others, which stay as they are."""

    text: str
    stale: tuple[str, ...]
    lacking: tuple[str, ...]


def update(file: Path, kept: Path, blocks: Mapping[str, Block]) -> Updated:
    """What the blocks of a Markdown file should be, by the records in the folder ``kept``.

    Raises ``BenchError`` for a file that can't be read, a marker without its partner, an unknown name, and a damaged
    record.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"Can't read {file}: {error}. Name the Markdown file whose tables are to be made.") from error
    stale, lacking, parts = [], [], []
    position = 0
    for name, start, end in _find(file, text):
        block = blocks[require_choice(f"{file}: table", name, blocks)]
        missing = [each for each in block.files if not (kept / each).is_file()]
        if missing:
            lacking.append(f"{name}: there is no {kept / missing[0]}")
            continue
        made = f"\n{block.make(kept, file.parent).strip()}\n"
        if made != text[start:end]:
            stale.append(name)
        parts += [text[position:start], made]
        position = end
    return Updated("".join([*parts, text[position:]]), tuple(stale), tuple(lacking))


def _find(file: Path, text: str) -> list[tuple[str, int, int]]:
    """Name of each block, and where what is between its markers starts and ends."""
    found = []
    name, start = "", 0
    for marker in MARKER.finditer(text):
        line = text.count("\n", 0, marker.start()) + 1
        is_end = marker[0] == _END
        if is_end != bool(name):
            lacks = "ends no table" if is_end else f"begins a table before {_END} of table {name}"
            raise BenchError(f"{file}, line {line}: {marker[0]} {lacks}. Put <!-- table: NAME --> and {_END} in pairs.")
        if is_end:
            found.append((name, start, marker.start()))
            name = ""
        else:
            opened = _START.fullmatch(marker[0])
            assert opened is not None
            name, start = opened[1], marker.end()
    if name:
        raise BenchError(f"{file}: {_END} of table {name} is missing. Put it on a line of its own below the table.")
    return found
