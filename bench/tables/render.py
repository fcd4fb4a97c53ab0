"""A table of runs for the terminal, and as Markdown, CSV and LaTeX (booktabs)."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console, JustifyMethod
from rich.table import Table

from bench.errors import BenchError
from bench.tables.collect import COLUMNS, Column, Row

UNKNOWN = "-"
_LATEX_SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}
# Parts of the stamp that a reader needs to know what a number is; the rest is in each run's metrics.json.
_STAMP = (
    "name",
    "holdout_every",
    "alignment",
    "rendered_depth",
    "depth_min_m",
    "depth_max_m",
    "ssim",
    "lpips_net",
    "right_images_mapped",
)


def shown(column: Column, row: Row) -> str:
    """A cell as people read it; "-" where the value is not known."""
    value = row.values.get(column.key)
    if value is None:
        return UNKNOWN
    if column.decimals is not None and isinstance(value, (int, float)):
        return f"{value:.{column.decimals}f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def print_table(rows: Sequence[Row], console: Console) -> None:
    """Print the table and its footnotes.

    A single run is printed as a list, which fits any terminal. Several are one line each: a line that is longer than
    the terminal is folded by the terminal and not cell by cell, so that it can be piped and searched.
    """
    table = Table(show_header=len(rows) > 1)
    if len(rows) == 1:
        for column in COLUMNS:
            table.add_row(_heading(column, " "), shown(column, rows[0]))
    else:
        for column in COLUMNS:
            justify: JustifyMethod = "right" if _is_number(column) else "left"
            table.add_column(_heading(column, "\n"), justify=justify, no_wrap=True)
        for row in rows:
            table.add_row(*(shown(column, row) for column in COLUMNS))
    # A table takes no more width than it needs, and its console's width at most.
    Console(file=console.file, width=10_000).print(table, markup=False)
    for note in footnotes(rows):
        console.print(note, markup=False, highlight=False, soft_wrap=True)


def as_markdown(rows: Sequence[Row]) -> str:
    """A Markdown table with all columns, and below it how the numbers were made and why some are missing."""
    lines = [
        "| " + " | ".join(_heading(column, " ") for column in COLUMNS) + " |",
        "|" + "|".join("---:" if _is_number(column) else "---" for column in COLUMNS) + "|",
    ]
    for row in rows:
        lines.append("| " + " | ".join(shown(column, row).replace("|", "\\|") for column in COLUMNS) + " |")
    notes = [f"- {note}" for note in footnotes(rows)]
    return "\n".join([*lines, *([""] if notes else []), *notes]) + "\n"


def as_csv(rows: Sequence[Row]) -> str:
    """All columns with full digits, headed by their keys (the unit is in the key); empty where not known."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.key for column in COLUMNS] + ["protocol"])
    for row in rows:
        values = [row.values.get(column.key) for column in COLUMNS]
        writer.writerow(["" if value is None else value for value in values] + [row.protocol.get("name", "")])
    return text.getvalue()


def as_latex(rows: Sequence[Row]) -> str:
    """A ``tabular`` with booktabs rules; needs ``\\usepackage{booktabs}``. Footnotes become comments."""
    alignment = "".join("r" if _is_number(column) else "l" for column in COLUMNS)
    lines = [f"% {note}" for note in footnotes(rows)]
    lines += [rf"\begin{{tabular}}{{{alignment}}}", r"\toprule"]
    lines.append(" & ".join(_latex(_heading(column, " ")) for column in COLUMNS) + r" \\")
    lines.append(r"\midrule")
    for row in rows:
        cells = [shown(column, row) for column in COLUMNS]
        lines.append(" & ".join("--" if cell == UNKNOWN else _latex(cell) for cell in cells) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    return "\n".join(lines) + "\n"


WRITERS: dict[str, Callable[[Sequence[Row]], str]] = {".md": as_markdown, ".csv": as_csv, ".tex": as_latex}


def writer_for(path: Path) -> Callable[[Sequence[Row]], str]:
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


def _latex(text: str) -> str:
    return "".join(_LATEX_SPECIAL.get(character, character) for character in text)
