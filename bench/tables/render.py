"""The table of runs as a document, and the notes on how its numbers were made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console

from bench.tables.collect import Column, Row, columns_of
from bench.tables.document import model
from bench.tables.document.model import UNKNOWN, Cell, Data, Document
from bench.tables.document.terminal import print_document
from bench.tables.static_camera import NAME, static_camera_rows

# Parts of the stamp that a reader needs to know what a number is; the rest is in each run's metrics.json.
_STAMP = (
    "name",
    "holdout_every",
    "alignment",
    "matched_by",
    "rendered_depth",
    "depth_min_m",
    "depth_max_m",
    "depth_mask",
    "sky",
    "ssim",
    "lpips_net",
    "right_images_mapped",
    "truth",
    "images",
    "averaging",
    "holes",
)


def runs_document(rows: Sequence[Row], columns: Sequence[Column] = (), name: str = "Runs") -> Document:
    """One row per run, then the static camera's for each data set; without the optional columns that no row has.

    The columns are by default those of the table of runs. The data has all of them, and the name of the protocol.
    """
    columns = columns or columns_of(rows)
    references = static_camera_rows(rows)
    first, *others = columns_with_values(rows, columns)
    blocks = [tuple(_row(row, first, others) for row in block) for block in (rows, references) if block]
    data = [row.values | {"protocol": row.protocol.get("name", "")} for row in (*rows, *references)]
    return Document(
        name=name,
        title="",
        left=(_heading(first),),
        columns=tuple(_heading(column) for column in others),
        blocks=tuple(blocks),
        notes=tuple(footnotes(rows)),
        data=Data((*(column.key for column in columns), "protocol"), data),
    )


def print_table(rows: Sequence[Row], console: Console, columns: Sequence[Column] = ()) -> None:
    """Print the table of runs with its notes; a single run is printed as a list, which fits any terminal."""
    columns = columns or columns_of(rows)
    document = runs_document(rows, columns)
    print_document(_as_list(rows[0], columns, document) if len(rows) == 1 else document, console)


def _as_list(row: Row, columns: Sequence[Column], document: Document) -> Document:
    """One line per column, and one for what a static camera has for an ATE."""
    lines = []
    for column in columns_with_values([row], columns):
        heading = _heading(column)
        name = f"{heading.title} {heading.below}".strip()
        lines.append(model.Row((name,), (Cell(shown(column, row)),)))
        if column.key == "ate_rmse_m":
            references = (Cell(shown(column, reference)) for reference in static_camera_rows([row]))
            lines += [model.Row((f"{name} of a {NAME}",), (cell,), "quiet") for cell in references]
    nameless = (model.Column(""),)
    return Document(document.name, "", nameless, nameless, (tuple(lines),), document.notes, document.data)


def shown(column: Column, row: Row) -> str:
    """A cell as people read it; "-" where the value is not known."""
    value = row.values.get(column.key)
    if value is None:
        return UNKNOWN
    if column.decimals is not None and isinstance(value, (int, float)):
        return f"{value:.{column.decimals}f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def columns_with_values(rows: Sequence[Row], columns: Sequence[Column]) -> list[Column]:
    """``columns`` without the optional ones that no row has a value for."""
    return [
        column
        for column in columns
        if not column.optional or any(row.values.get(column.key) is not None for row in rows)
    ]


def _row(row: Row, first: Column, others: Sequence[Column]) -> model.Row:
    cells = tuple(Cell(shown(column, row)) for column in others)
    return model.Row((shown(first, row),), cells, "quiet" if row.is_reference else "ours")


def _heading(column: Column) -> model.Column:
    is_number = column.decimals is not None or column.is_number
    return model.Column(column.title, f"[{column.unit}]" if column.unit else "", "right" if is_number else "left")


def footnotes(rows: Sequence[Row]) -> list[str]:
    """One line a protocol that was used (with its runs when there are several), and one a missing value."""
    users: dict[str, list[str]] = {}
    for row in rows:
        if row.protocol:
            stamp = ", ".join(f"{key} {_stamp_value(row.protocol.get(key))}" for key in _STAMP if key in row.protocol)
            users.setdefault(stamp, []).append(str(row.values["run"]))
    lines = []
    for stamp, runs in users.items():
        lines.append(f"Protocol{f' of {_listed(runs)}' if len(users) > 1 else ''}: {stamp}.")
    reasons: dict[str, list[str]] = {}
    for row in rows:
        for note in row.notes:
            reasons.setdefault(note, []).append(str(row.values["run"]))
    return lines + [f"{_listed(runs)}: {note}" for note, runs in reasons.items()]


def _listed(runs: list[str]) -> str:
    return ", ".join(runs[:3]) + (f" and {len(runs) - 3} more" if len(runs) > 3 else "")


def _stamp_value(value: Any) -> str:
    return "none" if value is None else str(value)
