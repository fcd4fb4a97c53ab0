"""The table of runs as a document, and the notes on how its numbers were made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console

from bench.tables.collect import Column, Row, columns_of
from bench.tables.document import model
from bench.tables.document.model import UNKNOWN, Cell, Data, Document
from bench.tables.document.terminal import print_document
from bench.tables.groups import COUNT, SEEDS, STD, GroupedRuns, group_runs
from bench.tables.static_camera import NAME, static_camera_rows
from bench.terminal import say

# Runs that have little in common differ in dozens of settings; a CSV file has them all.
_MOST_SETTINGS = 10
# From which size on a mean of whole numbers is shown without decimals.
_WHOLE_FROM = 100
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

    By default it is the table of runs: with a column for each setting in which they differ, and one row for those that
    differ in their seed alone. With ``columns`` of something else, each row is shown as it is. The data has all
    columns, the spreads, and the name of the protocol.
    """
    grouped = GroupedRuns(tuple(rows), ()) if columns else group_runs(rows)
    usual = columns or columns_of(rows)
    references = static_camera_rows(rows)
    counts = (SEEDS, COUNT) if grouped.has_groups else ()
    first, *others = usual
    shown_columns = columns_with_values(rows, others)
    shown_columns = [*grouped.settings[:_MOST_SETTINGS], *counts, *shown_columns]
    blocks = [tuple(_row(row, first, shown_columns) for row in block) for block in (grouped.rows, references) if block]
    notes = footnotes(rows)
    if unseen := grouped.settings[_MOST_SETTINGS:]:
        notes.append(f"The runs differ too in {', '.join(column.title for column in unseen)}; a CSV file has these.")
    return Document(
        name=name,
        title="",
        left=(_heading(first),),
        columns=tuple(_heading(column) for column in shown_columns),
        blocks=tuple(blocks),
        notes=tuple(notes),
        data=_data(grouped, references, usual, bool(columns)),
        # A row of one run is called by its folder's name.
        links=tuple((label, runs) for label, runs in grouped.folders() if len(runs) > 1),
    )


def runs_data(rows: Sequence[Row], average: bool) -> Data:
    """The data of the table of runs, without the static camera; ``average``: one row for runs that differ in the seed
    alone."""
    return _data(group_runs(rows, average), [], columns_of(rows), False)


def _data(grouped: GroupedRuns, references: Sequence[Row], usual: Sequence[Column], as_they_are: bool) -> Data:
    first, *others = usual
    keys = [first.key, *(column.key for column in grouped.settings)]
    keys += [] if as_they_are else [SEEDS.key, COUNT.key]
    for column in others:
        keys.append(column.key)
        if grouped.has_groups and column.is_number:
            keys.append(f"{column.key}{STD}")
    rows = [row.values | {"protocol": row.protocol.get("name", "")} for row in (*grouped.rows, *references)]
    return Data((*keys, "protocol"), rows)


def print_table(rows: Sequence[Row], console: Console, columns: Sequence[Column] = ()) -> None:
    """Print the table of runs with its notes and their folders; a single run is a list, which fits any terminal."""
    document = runs_document(rows, columns)
    if len(rows) == 1:
        print_document(_as_list(rows[0], columns or columns_of(rows), document), console)
        return
    print_document(document, console)
    for label, runs in group_runs(rows).folders() if not columns else ():
        for seed, place in runs:
            say(f"{label}, seed {seed}: {place}", console)


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
    value, spread = row.values.get(column.key), row.values.get(f"{column.key}{STD}")
    if value is None:
        return UNKNOWN
    return _in_digits(column, value) + (
        "" if spread is None or isinstance(value, int) else f" ± {_in_digits(column, spread)}"
    )


def _in_digits(column: Column, value: Any) -> str:
    if isinstance(value, int):
        return f"{value:,}" if column.decimals is None else f"{value:.{column.decimals}f}"
    if not isinstance(value, float):
        # A setting that a search has chosen has more digits than anyone reads; a CSV file has them.
        return f"{float(value):.6g}" if column.is_number and "." in value else str(value)
    # A mean of whole numbers.
    decimals = (0 if abs(value) >= _WHOLE_FROM else 1) if column.decimals is None else column.decimals
    return f"{value:,.{decimals}f}" if column.decimals is None else f"{value:.{decimals}f}"


def columns_with_values(rows: Sequence[Row], columns: Sequence[Column]) -> list[Column]:
    """``columns`` without the optional ones that no row has a value for."""
    return [
        column
        for column in columns
        if not column.optional or any(row.values.get(column.key) is not None for row in rows)
    ]


def _row(row: Row, first: Column, others: Sequence[Column]) -> model.Row:
    cells = tuple(Cell(shown(column, row)) for column in others)
    name = f"{len(row.runs)} runs" if len(row.runs) > 1 else shown(first, row)
    return model.Row((name,), cells, "quiet" if row.is_reference else "ours")


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
