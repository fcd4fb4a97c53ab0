"""A document as Markdown."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from bench.plain_text import plain_line
from bench.tables.document.model import UNKNOWN, Cell, Column, Document

# Signs that mean something in Markdown or in the HTML that it may hold.
_ESCAPED = str.maketrans({**{sign: f"\\{sign}" for sign in "\\|_*`~"}, "&": "&amp;", "<": "&lt;"})


def as_markdown(document: Document) -> str:
    """Title, table and notes, then links to the runs."""
    columns = [*document.left, *document.columns]
    lines = [f"**{escaped(document.title)}**", ""] if document.title else []
    lines += [row([_head(column) for column in columns])]
    lines += ["|" + "".join("---:|" if column.align == "right" else "---|" for column in columns)]
    for block in document.blocks:
        for line in block:
            cells = [_cell(cell, line.kind == "quiet") for cell in line.cells]
            lines.append(row([*map(escaped, line.names), *cells]))
    notes = [_note(note) for note in document.notes]
    notes += [f"- Runs of {escaped(of)}: {_links(document, runs)}" for of, runs in document.links]
    return "\n".join([*lines, *([""] if notes else []), *notes]) + "\n"


def row(cells: Sequence[str]) -> str:
    """A line of a Markdown table, of cells that are Markdown."""
    return "| " + " | ".join(cells) + " |"


def escaped(text: str) -> str:
    """Markdown that shows ``text``, also in a cell."""
    return plain_line(text).translate(_ESCAPED).replace("](", "]\\(").replace("]:", "]\\:")


def _note(text: str) -> str:
    """A note as an item of a list, which begins no heading, quotation, list or task of its own."""
    inside = escaped(text.lstrip())
    return "- " + re.sub(r"^(\d*)(?=[#>+-]|(?<=\d)[.)]|\[[ xX]\])", r"\1\\", inside)


def _head(column: Column) -> str:
    return escaped(f"{column.title} {column.below}".strip())


def _cell(cell: Cell, quiet: bool) -> str:
    text = escaped(cell.text)
    if not text:
        return ""
    text = f"**{text}**" if cell.best else f"*{text}*" if quiet and text != UNKNOWN else text
    return text + (f" ({cell.n})" if cell.n else "") + cell.mark


def _links(document: Document, runs: Sequence[tuple[str, Path]]) -> str:
    return " ".join(f"[{escaped(name)}](<{document.link(place)}>)" for name, place in runs)
