"""The formats that a document can be written in, by their file extensions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from bench.errors import BenchError, require_choice
from bench.io.atomic import write_text
from bench.tables.document.csv_text import as_csv
from bench.tables.document.latex import as_latex
from bench.tables.document.markdown import as_markdown
from bench.tables.document.model import Document
from bench.tables.document.page import as_html

_WRITERS: dict[str, Callable[[Document], str]] = {
    "md": as_markdown,
    "csv": as_csv,
    "tex": as_latex,
    "html": as_html,
}
FORMS = tuple(_WRITERS)


def text_of(document: Document, form: str, folder: Path) -> str:
    """The document as "md", "csv", "tex" or "html", with links relative to ``folder``; ``BenchError`` for another."""
    return _WRITERS[require_choice("--format", form, FORMS)](replace(document, folder=folder))


def form_of(path: Path, others: str = "") -> str:
    """The form that a file's extension says; ``BenchError`` for another extension, which names ``others`` too."""
    form = path.suffix.removeprefix(".")
    if form not in FORMS:
        forms = ", .".join(FORMS)
        raise BenchError(f"--out {path}: the extension says the form, and must be one of .{forms}{others}.")
    return form


def save(path: Path, text: str) -> None:
    """Write a file, and make its folder first; raises ``BenchError`` for a folder that can't be made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"Can't make the folder of --out {path}: {error.strerror}. Give another place.") from error
    write_text(path, text)
