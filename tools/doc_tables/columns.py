"""Tables of kept runs with columns of one's own choice."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.errors import BenchError
from bench.tables.document.markdown import row as markdown_row
from bench.tables.named.overrides import holds
from bench.tables.records.file import read_record_file
from bench.tables.records.made import made_in_words
from bench.tables.records.record import RunRecord, is_number

Runs = Sequence[RunRecord]


@dataclass(frozen=True)
class RunColumn:
    """A column: its heading, and the text for the runs of a row."""

    heading: str
    text: Callable[[Runs], str]


@dataclass(frozen=True)
class FixedRow:
    """A row that is not of our runs: its cells, as they are to be shown."""

    cells: tuple[str, ...]


def read_kept(file: Path) -> list[RunRecord]:
    """The runs of a record file; raises ``BenchError`` where it is damaged or holds none."""
    runs = list(read_record_file(file).runs)
    if not runs:
        raise BenchError(f"{file} holds no run. Make it again with `bgs-bench table RUN_FOLDER ... --out {file}`.")
    return runs


def number(run: RunRecord, path: str) -> float | None:
    """A number of ``metrics.json`` by its dotted name ("views.left.ssim"), a sum where several are joined by "+"."""
    total = 0.0
    for each in path.split("+"):
        value: Any = run.metrics
        for part in each.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if not is_number(value):
            return None
        total += value
    return total


def figures(template: str, *paths: str, scale: float = 1.0) -> Callable[[Runs], str]:
    """The means over a row's runs, in the places of ``template``; empty where a run lacks one of them.

    The first number has its sample standard deviation beside it where there are several runs.
    """

    def text(runs: Runs) -> str:
        columns = [[number(run, path) for run in runs] for path in paths]
        known = [[value * scale for value in column if value is not None] for column in columns]
        if not runs or any(len(column) < len(runs) for column in known):
            return ""
        shown = template.format(*(statistics.fmean(column) for column in known))
        if len(runs) == 1:
            return shown
        first = template[: template.index("}") + 1]
        spread = first[first.index("{") :].format(statistics.stdev(known[0]))
        head = first.format(statistics.fmean(known[0]))
        return f"{head} ± {spread}{shown.removeprefix(head)}"

    return text


def median(runs: Runs, path: str) -> float:
    """The median of a number over runs; raises ``BenchError`` where one lacks it."""
    values = [number(run, path) for run in runs]
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        raise BenchError(
            f"Not every one of the runs {', '.join(run.name for run in runs)} has {path}; score them again."
        )
    return statistics.median(known)


def by_settings(runs: Runs, rows: Sequence[str]) -> dict[str, list[RunRecord]]:
    """The runs of each row, a row being overrides separated by blanks; a run belongs to the one that says most of it.

    Raises ``BenchError`` for a run that belongs to none.
    """
    found: dict[str, list[RunRecord]] = {row: [] for row in rows}
    for run in runs:
        fitting = [row for row in rows if all(holds(run.config, override) for override in row.split())]
        if not fitting:
            raise BenchError(f"The kept run {run.name} belongs to none of the rows {'; '.join(rows)}.")
        found[max(fitting, key=lambda row: len(row.split()))].append(run)
    return found


def run_table(columns: Sequence[RunColumn], rows: Sequence[Runs | FixedRow]) -> str:
    """A Markdown table with a line for each row, numbers to the right of the first column."""
    cells = [row.cells if isinstance(row, FixedRow) else [column.text(row) for column in columns] for row in rows]
    return text_table([column.heading for column in columns], cells)


def text_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table of texts that are Markdown."""
    return "\n".join([markdown_row(headings), "|" + "---|" * len(headings), *map(markdown_row, rows)])


def made_by(runs: Runs, file: Path, folder: Path) -> str:
    """When, from which code, on what and with which seeds the runs were made, with a link to their record."""
    seeds = sorted({run.seed for run in runs})
    protocols = sorted({str(run.protocol["name"]) for run in runs if "name" in run.protocol})
    parts = [
        f"{len(runs)} runs" if len(runs) > 1 else "1 run",
        f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}",
        *([f"protocol {', '.join(protocols)}"] if protocols else []),
        *made_in_words(runs),
        f"[record]({link(file, folder)})",
    ]
    return f"*{'; '.join(parts)}*"


def link(file: Path, folder: Path) -> str:
    """Path of a kept file as it is written in a Markdown file in ``folder``."""
    return Path(os.path.relpath(file, folder)).as_posix()
