"""The numbers behind a document as CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from bench.plain_text import plain_line
from bench.tables.document.model import Data, Document, relative

_FORMULA = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")
"""With these, the last four full-width, a spreadsheet begins to compute."""


def as_csv(document: Document) -> str:
    """All numbers with full digits, headed by their keys; empty where not known.

    Text is one line of plain text; one that a spreadsheet would take for a formula begins with an apostrophe there.
    """
    return data_as_csv(document.data, document.folder)


def data_as_csv(data: Data, folder: Path) -> str:
    """As ``as_csv``, of numbers that are no document's; paths become relative to ``folder``."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(_text, data.columns))
    writer.writerows([_value(row.get(column), folder) for column in data.columns] for row in data.rows)
    return text.getvalue()


def _value(value: Any, folder: Path) -> Any:
    if isinstance(value, tuple):
        return _text(" ".join(relative(path, folder) for path in value))
    if isinstance(value, str):
        return _text(value)
    return "" if value is None else value


def _text(value: str) -> str:
    plain = plain_line(value)
    return f"'{plain}" if plain.startswith(_FORMULA) and not _is_number(plain) else plain


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
