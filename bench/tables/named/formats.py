"""A named table for the terminal, and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.tables.named.grid import Grid, GridCell
from bench.tables.named.layout import Document, is_quiet, left_headings, left_names, plain

# Long names of methods are broken, so that the six sequences of a main table fit 160 columns.
_NAME_WIDTH = 20
_ANY_WIDTH = 10_000


def print_grid(document: Document, console: Console) -> None:
    """Print table and notes; on a terminal that is too narrow, the table in several parts, one below the other.

    What is piped is one table, as wide as it needs.
    """
    columns = range(len(document.grid.columns))
    for part in _fitting(document.grid, columns, console):
        Console(file=console.file, width=_ANY_WIDTH, force_terminal=console.is_terminal).print(
            _table(document.grid, part)
        )
    for note in document.notes:
        console.print(note, markup=False, highlight=False, soft_wrap=True)


def _fitting(grid: Grid, columns: Sequence[int], console: Console) -> list[Sequence[int]]:
    """The columns, halved until each part fits the terminal."""
    # A console measures no more than its own width.
    width = Console(width=_ANY_WIDTH).measure(_table(grid, columns)).maximum
    if not console.is_terminal or len(columns) == 1 or width <= console.width:
        return [columns]
    middle = (len(columns) + 1) // 2
    return [*_fitting(grid, columns[:middle], console), *_fitting(grid, columns[middle:], console)]


def _table(grid: Grid, columns: Sequence[int]) -> Table:
    table = Table(title=grid.title, title_justify="left")
    for name in left_headings(grid):
        # The notes that explain the marks use the same words; only methods have long names.
        table.add_column(name, max_width=_NAME_WIDTH if name == "Method" else None, no_wrap=name != "Method")
    for column in columns:
        heading = Text(grid.columns[column].replace(" (", "\n("))
        table.add_column(heading, justify="right", no_wrap=True)
    for block in grid.blocks:
        for line, names in zip(block, left_names(grid, block), strict=True):
            cells = [line.cells[column] for column in columns]
            shown = [Text(plain(cell), style="bold" if cell.best else "") for cell in cells]
            table.add_row(*(Text(name) for name in names), *shown, style="dim italic" if is_quiet(line) else "")
        table.add_section()
    return table


def as_markdown(document: Document) -> str:
    """Title, table and notes; each of our numbers links to its runs, named by their seeds."""
    grid = document.grid
    left = left_headings(grid)
    lines = [f"**{_escaped(grid.title)}**", "", _row([*left, *map(_escaped, grid.columns)])]
    lines.append("|" + "---|" * len(left) + "---:|" * len(grid.columns))
    for block in grid.blocks:
        for line, names in zip(block, left_names(grid, block), strict=True):
            cells = [_cell(document, cell, is_quiet(line)) for cell in line.cells]
            lines.append(_row([*(_escaped(name) for name in names), *cells]))
    return "\n".join([*lines, "", *(f"- {_escaped(note)}" for note in document.notes)]) + "\n"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("|", "\\|").replace("_", "\\_").replace("<", "&lt;")


def _cell(document: Document, cell: GridCell, quiet: bool) -> str:
    text = _escaped(cell.text)
    if not text:
        return ""
    text = f"**{text}**" if cell.best else f"*{text}*" if quiet else text
    links = " ".join(f"[{seed}](<{document.link(run)}>)" for seed, run in cell.runs)
    parts = ": ".join(part for part in (str(cell.n) if cell.n else "", links) if part)
    return text + (f" ({parts})" if parts else "") + cell.mark
