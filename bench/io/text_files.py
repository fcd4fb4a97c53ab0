"""Text files that people and other programs wrote: every reader of one gets its text here."""

from __future__ import annotations

import codecs
from pathlib import Path

from bench.errors import BenchError

_MARK = "\ufeff"
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path, what: str = "file") -> str:
    """The text of a file without byte order marks; UTF-8, or UTF-16 where a mark at its beginning says so.

    ``what`` names the file in messages. Raises ``BenchError`` where it is missing or can't be read, and, with the line,
    where it is no text.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise BenchError(f"The {what} {path} does not exist. Check the path, or restore the file.") from None
    except OSError as error:
        raise BenchError(f"Can't read the {what} {path}: {error.strerror}. It must be a text file.") from None
    return decode(content, path, what)


def decode(content: bytes, path: Path, what: str = "file") -> str:
    """As ``read_text``, of what was read from ``path`` already."""
    encoding = "utf-16" if content.startswith(_UTF_16) else "utf-8"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content[: error.start].decode(encoding, errors="ignore").count("\n") + 1
        raise _no_text(path, what, line, f"byte 0x{content[error.start]:02x} is not {encoding.upper()}") from None
    if "\0" in text:
        line = text[: text.index("\0")].count("\n") + 1
        raise _no_text(path, what, line, "a zero byte, as in UTF-16 without a mark or in a binary file")
    # Marks also stand in the middle, where files were joined.
    return text.replace(_MARK, "")


def _no_text(path: Path, what: str, line: int, why: str) -> BenchError:
    return BenchError(f"Can't read the {what} {path}, line {line}: {why}. It must be a text file; save it as UTF-8.")
