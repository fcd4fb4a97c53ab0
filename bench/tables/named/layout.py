"""A filled grid as a document: its headings, and the names on the left."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from bench.tables.document.model import Column, Data, Document, Row
from bench.tables.named.grid import COMPUTED, ELSEWHERE, OURS, Grid, Line, heading

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
    )


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
