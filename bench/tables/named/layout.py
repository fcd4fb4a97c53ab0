"""A filled grid as a document: its headings, and the names on the left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Literal

from bench.tables.document.model import Cell, Column, Data, Document, Row
from bench.tables.named.grid import COMPUTED, DAGGER, ELSEWHERE, OURS, PAPER, Grid, heading

_KINDS: dict[str, Literal["ours", "quiet"]] = {OURS: "ours", ELSEWHERE: "quiet", COMPUTED: "quiet"}
_OUR_SIDE = (OURS, COMPUTED)


def document_of(grid: Grid, notes: Sequence[str], data: Data) -> Document:
    """The grid with its notes and the numbers behind it."""
    names, columns, blocks = _beside(grid) if grid.beside else _below(grid)
    return Document(
        name=grid.name,
        title=grid.title,
        # The notes that explain the marks use the same words as other columns; only methods have long names.
        left=tuple(Column(name, wraps=name == "Method") for name in names),
        columns=columns,
        blocks=blocks,
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


_Layout = tuple[list[str], tuple[Column, ...], tuple[tuple[Row, ...], ...]]


def _below(grid: Grid) -> _Layout:
    """A line for each metric and whose number it is; a method and a metric are named once."""
    has_several = len({line.by for block in grid.blocks for line in block}) > 1 or not grid.has_metric_column
    names = ["Method", *(["Metric"] if grid.has_metric_column else []), *(["By"] if has_several else [])]
    blocks = []
    for block in grid.blocks:
        rows = []
        method: str | None = None
        metric: str | None = None
        for line in block:
            title = heading(line.metric) if line.metric is not None else ""
            named = ["" if line.method == method else line.method]
            named += ["" if title == metric else title] if grid.has_metric_column else []
            named += [line.by] if has_several else []
            rows.append(Row(tuple(named), line.cells, _KINDS.get(line.by, "others")))
            method, metric = line.method, title
        blocks.append(tuple(rows))
    return names, grid.columns, tuple(blocks)


def _beside(grid: Grid) -> _Layout:
    """A line for each method: of each metric our number and the paper's, where the table has both."""
    lines = [line for block in grid.blocks for line in block]
    sides = [is_ours for is_ours in (True, False) if any((line.by in _OUR_SIDE) == is_ours for line in lines)]
    columns = grid.columns
    if len(sides) > 1:
        columns = tuple(replace(column, below=side) for column in grid.columns for side in ("", PAPER))
    rows = []
    for block in grid.blocks:
        by_side = {line.by in _OUR_SIDE: line.cells for line in block}
        runs, ours = _runs_of(by_side.get(True, ()))
        empty = (Cell(),) * len(grid.columns)
        shown = [(ours if is_ours else by_side.get(False, ())) or empty for is_ours in sides]
        names = (block[0].method, *([runs] if True in sides else []))
        rows.append(Row(names, tuple(chain.from_iterable(zip(*shown, strict=True))), _KINDS.get(block[0].by, "others")))
    return ["Method", *(["Runs"] if True in sides else [])], columns, (tuple(rows),)


def _runs_of(cells: tuple[Cell, ...]) -> tuple[str, tuple[Cell, ...]]:
    """How many runs the numbers of a line are of, with a mark that all of them have; the cells keep what differs."""
    known = [cell for cell in cells if cell.value is not None and cell.n]
    if not known:
        return "", cells
    most, marks = max(cell.n for cell in known), {cell.mark for cell in known}
    mark = marks.pop() if len(marks) == 1 else ""
    rest = (
        replace(cell, n=0 if cell.n == most else cell.n, mark="" if cell.mark == mark else cell.mark) for cell in cells
    )
    return f"{most}{mark}", tuple(rest)
