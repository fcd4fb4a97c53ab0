"""What all forms of a named table have in common: the document, its headings and the names on the left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.tables.named.grid import COMPUTED, ELSEWHERE, Grid, GridCell, Line, heading
from bench.tables.named.links import relative


@dataclass(frozen=True)
class Document:
    """A grid, the notes below it, and the folder that its links are relative to."""

    grid: Grid
    notes: Sequence[str]
    folder: Path

    def link(self, run: Path) -> str:
        """What leads to a run, seen from the document."""
        return relative(run, self.folder)


def left_headings(grid: Grid) -> list[str]:
    """The headings of the columns with names, which come before those with numbers."""
    return ["Method", "Metric", "By"] if grid.has_metric_column else ["Method", "By"]


def left_names(grid: Grid, block: Sequence[Line]) -> list[list[str]]:
    """The cells on the left of each line: a method and a metric are named once."""
    named = []
    method: str | None = None
    metric: str | None = None
    for line in block:
        title = heading(line.metric) if line.metric is not None else ""
        names = ["" if line.method == method else line.method]
        names += ["" if title == metric else title] if grid.has_metric_column else []
        named.append([*names, line.by])
        method, metric = line.method, title
    return named


def is_quiet(line: Line) -> bool:
    """Lines that are no method of the paper's or ours, but marks to compare with."""
    return line.by in (ELSEWHERE, COMPUTED)


def plain(cell: GridCell) -> str:
    """The text of a cell, with the number of runs and its mark."""
    return cell.text + (f" ({cell.n})" if cell.n else "") + cell.mark
