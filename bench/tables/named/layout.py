"""A filled grid as a document: its headings, and the names on the left."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from bench.tables.document.model import Column, Data, Document, Row
from bench.tables.named.grid import COMPUTED, DAGGER, ELSEWHERE, OURS, Grid, Line, heading

_KINDS: dict[str, Literal["ours", "quiet"]] = {OURS: "ours", ELSEWHERE: "quiet", COMPUTED: "quiet"}


def document_of(grid: Grid, notes: Sequence[str], data: Data) -> Document:
    """The grid with its notes and the numbers behind it."""
    names = ["Method", "Metric", "By"] if grid.has_metric_column else ["Method", "By"]
    return Document(
        name=grid.name,
        title=grid.title,
        # The notes that explain the marks use the same words as other columns; only methods have long names.
        left=tuple(Column(name, wraps=name == "Method") for name in names),
        columns=grid.columns,
        blocks=tuple(_rows(grid, block) for block in grid.blocks),
        notes=tuple(notes),
        data=data,
        links=_links(grid),
    )


def _links(grid: Grid) -> tuple[tuple[str, tuple[tuple[str, Path], ...]], ...]:
    """Where the runs of each method are, by their seeds, in a table of sequences by sequence and seed."""
    found: dict[str, dict[str, Path]] = {}
    for line in (line for block in grid.blocks for line in block):
        for column, cell in zip(grid.columns, line.cells, strict=True):
            for seed, place in cell.links:
                name = f"{column.title}:{seed}" if grid.has_metric_column else seed
                found.setdefault(line.method.rstrip(DAGGER), {})[name] = place
    return tuple((method, tuple(runs.items())) for method, runs in found.items())


def _rows(grid: Grid, block: Sequence[Line]) -> tuple[Row, ...]:
    """A method and a metric are named once."""
    rows = []
    method: str | None = None
    metric: str | None = None
    for line in block:
        title = heading(line.metric) if line.metric is not None else ""
        names = ["" if line.method == method else line.method]
        names += ["" if title == metric else title] if grid.has_metric_column else []
        rows.append(Row((*names, line.by), line.cells, _KINDS.get(line.by, "others")))
        method, metric = line.method, title
    return tuple(rows)
