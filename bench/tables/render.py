"""A table of runs for the terminal, and as Markdown, CSV and LaTeX (booktabs)."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console, JustifyMethod
from rich.table import Table

from bench.errors import BenchError
from bench.tables.collect import COLUMNS, Column, Row
from bench.tables.latex import latex_text
from bench.tables.static_camera import NAME, static_camera_rows

UNKNOWN = "-"
_REFERENCE_STYLE = "dim italic"
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


def shown(column: Column, row: Row) -> str:
    """A cell as people read it; "-" where the value is not known."""
    value = row.values.get(column.key)
    if value is None:
        return UNKNOWN
    if column.decimals is not None and isinstance(value, (int, float)):
        return f"{value:.{column.decimals}f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def columns_with_values(rows: Sequence[Row], columns: Sequence[Column] = COLUMNS) -> list[Column]:
    """``columns`` without the optional ones that no row has a value for."""
    return [
        column
        for column in columns
        if not column.optional or any(row.values.get(column.key) is not None for row in rows)
    ]


def print_table(rows: Sequence[Row], console: Console, columns: Sequence[Column] = COLUMNS) -> None:
    """Print the table, with a static camera's row for each data set, and its footnotes.

    A single run is printed as a list, which fits any terminal. Several are one line each: a line that is longer than
    the terminal is folded by the terminal and not cell by cell, so that it can be piped and searched.
    """
    shown_columns = columns_with_values(rows, columns)
    references = static_camera_rows(rows)
    table = Table(show_header=len(rows) > 1)
    if len(rows) == 1:
        for column in shown_columns:
            table.add_row(_heading(column, " "), shown(column, rows[0]))
            if column.key == "ate_rmse_m":
                for reference in references:
                    heading = f"{_heading(column, ' ')} of a {NAME}"
                    table.add_row(heading, shown(column, reference), style=_REFERENCE_STYLE)
    else:
        for column in shown_columns:
            justify: JustifyMethod = "right" if _is_number(column) else "left"
            table.add_column(_heading(column, "\n"), justify=justify, no_wrap=True)
        for row in rows:
            table.add_row(*(shown(column, row) for column in shown_columns))
        table.add_section()
        for row in references:
            table.add_row(*(shown(column, row) for column in shown_columns), style=_REFERENCE_STYLE)
    # A table takes no more width than it needs, and its console's width at most.
    Console(file=console.file, width=10_000).print(table, markup=False)
    for note in footnotes(rows):
        console.print(note, markup=False, highlight=False, soft_wrap=True)


def as_markdown(rows: Sequence[Row], columns: Sequence[Column] = COLUMNS) -> str:
    """A Markdown table with all columns, and below it how the numbers were made and why some are missing.

    The static camera's rows come last, in italics.
    """
    columns = columns_with_values(rows, columns)
    lines = [
        "| " + " | ".join(_heading(column, " ") for column in columns) + " |",
        "|" + "|".join("---:" if _is_number(column) else "---" for column in columns) + "|",
    ]
    for row in [*rows, *static_camera_rows(rows)]:
        cells = [shown(column, row).replace("|", "\\|") for column in columns]
        if row.is_reference:
            cells = [cell if cell == UNKNOWN else f"*{cell}*" for cell in cells]
        lines.append("| " + " | ".join(cells) + " |")
    notes = [f"- {note}" for note in footnotes(rows)]
    return "\n".join([*lines, *([""] if notes else []), *notes]) + "\n"


def as_csv(rows: Sequence[Row], columns: Sequence[Column] = COLUMNS) -> str:
    """All columns with full digits, headed by their keys (the unit is in the key); empty where not known.

    The static camera's rows come last; they have that name in the column ``run``.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.key for column in columns] + ["protocol"])
    for row in [*rows, *static_camera_rows(rows)]:
        values = [row.values.get(column.key) for column in columns]
        writer.writerow(["" if value is None else value for value in values] + [row.protocol.get("name", "")])
    return text.getvalue()


def as_latex(rows: Sequence[Row], columns: Sequence[Column] = COLUMNS) -> str:
    """A ``tabular`` with booktabs rules; needs ``\\usepackage{booktabs}``. Footnotes become comments.

    The static camera's rows come last, in italics below a rule.
    """
    columns = columns_with_values(rows, columns)
    references = static_camera_rows(rows)
    alignment = "".join("r" if _is_number(column) else "l" for column in columns)
    lines = [f"% {note}" for note in footnotes(rows)]
    lines += [rf"\begin{{tabular}}{{{alignment}}}", r"\toprule"]
    lines.append(" & ".join(latex_text(_heading(column, " ")) for column in columns) + r" \\")
    lines.append(r"\midrule")
    lines += [_latex_row(row, columns) for row in rows]
    lines += [r"\midrule"] if references else []
    lines += [_latex_row(row, columns) for row in references]
    lines += [r"\bottomrule", r"\end{tabular}"]
    return "\n".join(lines) + "\n"


def _latex_row(row: Row, columns: Sequence[Column]) -> str:
    cells = ["--" if cell == UNKNOWN else latex_text(cell) for cell in (shown(column, row) for column in columns)]
    if row.is_reference:
        cells = [cell if cell == "--" else rf"\textit{{{cell}}}" for cell in cells]
    return " & ".join(cells) + r" \\"


class Writer(Protocol):
    """Makes the text of a table file of these rows and columns."""

    def __call__(self, rows: Sequence[Row], columns: Sequence[Column] = COLUMNS) -> str: ...


WRITERS: dict[str, Writer] = {".md": as_markdown, ".csv": as_csv, ".tex": as_latex}


def writer_for(path: Path) -> Writer:
    """The writer that goes with a file's extension; raises ``BenchError`` for another extension."""
    if path.suffix not in WRITERS:
        raise BenchError(
            f"--out {path}: the extension says the form, and must be one of {', '.join(WRITERS)}. Run folders go first."
        )
    return WRITERS[path.suffix]


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


def _is_number(column: Column) -> bool:
    return column.decimals is not None or column.key == "gaussians"


def _heading(column: Column, gap: str) -> str:
    return f"{column.title}{gap}[{column.unit}]" if column.unit else column.title
