"""The numbers behind a document as CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from bench.tables.document.model import Data, Document, relative


def as_csv(document: Document) -> str:
    """All numbers with full digits, headed by their keys; empty where not known."""
    return data_as_csv(document.data, document.folder)


def data_as_csv(data: Data, folder: Path) -> str:
    """As ``as_csv``, of numbers that are no document's; paths become relative to ``folder``."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(data.columns)
    writer.writerows([_value(row.get(column), folder) for column in data.columns] for row in data.rows)
    return text.getvalue()


def _value(value: Any, folder: Path) -> Any:
    if isinstance(value, tuple):
        return " ".join(relative(path, folder) for path in value)
    return "" if value is None else value
