"""A document on a terminal, or piped."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.plain_text import plain_line
from bench.tables.document.model import Column, Document
from bench.terminal import say

# Long names of methods are broken, so that the six sequences of a main table fit 160 columns.
_NAME_WIDTH = 20
_ANY_WIDTH = 10_000


def print_document(document: Document, console: Console) -> None:
    """Print table and notes; on a terminal that is too narrow, the table in several parts, one below the other.

    What is piped is one table, as wide as it needs.
    """
    for part in _fitting(document, range(len(document.columns)), console):
        wide = Console(file=console.file, width=_ANY_WIDTH, force_terminal=console.is_terminal)
        wide.print(_table(document, part))
    for note in document.notes:
        say(note, console)


def _fitting(document: Document, columns: Sequence[int], console: Console) -> list[Sequence[int]]:
    """The columns, halved until each part fits the terminal."""
    # A console measures no more than its own width.
    width = Console(width=_ANY_WIDTH).measure(_table(document, columns)).maximum
    if not console.is_terminal or len(columns) == 1 or width <= console.width:
        return [columns]
    middle = (len(columns) + 1) // 2
    return [*_fitting(document, columns[:middle], console), *_fitting(document, columns[middle:], console)]


def _table(document: Document, columns: Sequence[int]) -> Table:
    shown = [document.columns[column] for column in columns]
    has_heads = any(column.title for column in (*document.left, *shown))
    table = Table(
        title=Text(plain_line(document.title)) if document.title else None, title_justify="left", show_header=has_heads
    )
    for column in (*document.left, *shown):
        max_width = _NAME_WIDTH if column.wraps else None
        table.add_column(_head(column), justify=column.align, max_width=max_width, no_wrap=not column.wraps)
    for block in document.blocks:
        for row in block:
            cells = [row.cells[column] for column in columns]
            texts = [Text(plain_line(cell.plain), style="bold" if cell.best else "") for cell in cells]
            names = (Text(plain_line(name)) for name in row.names)
            table.add_row(*names, *texts, style="dim italic" if row.kind == "quiet" else "")
        table.add_section()
    return table


def _head(column: Column) -> Text:
    return Text("\n".join(plain_line(part) for part in (column.title, column.below) if part))
