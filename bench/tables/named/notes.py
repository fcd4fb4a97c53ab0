"""What stands below a named table: how to read it, on which data and under which settings its numbers were made."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

from bench.tables.collect import Row
from bench.tables.named.definitions import NamedTable
from bench.tables.named.fill import FilledTable, differences
from bench.tables.named.grid import COMPARED, CROSS, DAGGER, OURS, PAPER, Grid, PublishedNumbers
from bench.tables.named.published import AVERAGE, PublishedValue
from bench.tables.records.made import made_in_words
from bench.tables.records.record import VIEW_GROUPS, RunRecord
from bench.tables.render import footnotes

# Of a run's settings, what a reader wants to know first; the rest is in each run's config.yaml.
_STATED = (
    ("dataset.frames", "frames"),
    ("dataset.scale", "images scaled by"),
    ("stereo.name", "stereo"),
    ("sky.name", "sky"),
    ("tracker.name", "tracker"),
    ("tracker.iterations", "tracking iterations"),
    ("mapper.name", "mapper"),
    ("mapper.iterations", "iterations"),
    ("mapper.rasterizer.name", "rasterizer"),
)
_UNSAID = {"dataset.scale": "1.0"}


def notes(
    filled: FilledTable,
    published: PublishedNumbers,
    grid: Grid,
    views: str,
    problems: Sequence[str],
    columns_of: str = "both",
) -> list[str]:
    """One sentence or two each; nothing that depends on when or where the table was made.

    ``columns_of``: whose numbers the table has.
    """
    table = filled.table
    found = [_legend(filled, grid, views, columns_of)]
    found += [table.about] if table.about and columns_of != "ours" else []
    found += _withheld(filled)
    if columns_of == "paper":
        return found + _about_published(table, published, grid)
    found += _parts(filled)
    found += _weak_or_lost(filled)
    found += _protocols(filled)
    found += _settings(filled)
    found += _fewer_iterations(filled)
    found += [f"{row.label}: {row.note}" for row in table.rows if row.note and filled.has_runs(row.label)]
    found += _external(filled)
    if different := differences(filled):
        found.append(f"Settings that differ between cells that are compared: {', '.join(different)}.")
    shown = _shown_runs(filled)
    if shown:
        if made := made_in_words([run for _, run in shown]):
            found.append(f"Made {'; '.join(made)}.")
        rows = [Row({"run": where}, dict(run.protocol), run.notes) for where, run in shown]
        found += footnotes(rows)
    found += [f"{row}, {sequence}: {note}." for (row, sequence), cell in filled.cells.items() for note in cell.notes]
    if filled.left_out:
        runs = "1 run belongs" if filled.left_out == 1 else f"{filled.left_out} runs belong"
        found.append(f"{runs} to no cell of this table.")
    found += [f"Not read: {problem}" for problem in problems]
    return found + (_about_published(table, published, grid) if columns_of == "both" else [])


def _numbers(filled: FilledTable, grid: Grid) -> str:
    """Whose numbers there are, and how they are to be read."""
    sides = {line.by for block in grid.blocks for line in block}
    if OURS not in sides:
        return "Numbers as they were published. Bold: the best."
    mean = f"ean ± sample standard deviation over seeds ({'Runs: how many' if grid.beside else 'number of runs'})"
    if not sides & {PAPER, COMPARED}:
        return f"M{mean}. Bold: the best."
    whose, where = ("Ours", "beside") if grid.beside else ("Lines ours", "below")
    alone = ""
    if grid.beside and COMPARED in sides:
        methods = {line.method for block in grid.blocks for line in block if line.by == COMPARED}
        others = dict.fromkeys(row.compared_with for row in filled.table.rows if row.label in methods)
        alone = f" (alone where the paper has no such method: minus its {', '.join(others)})"
    return (
        f"{whose}: m{mean}; {where} it the paper's number, and in brackets ours minus the paper's{alone}. "
        "Bold: the best of the paper's numbers, and the best of ours."
    )


def _legend(filled: FilledTable, grid: Grid, views: str, columns_of: str) -> str:
    cells = [cell for block in grid.blocks for line in block for cell in line.cells]
    text = _numbers(filled, grid)
    if any(column.below for column in grid.columns):
        text += " Below a sequence: km/frames, as in the paper."
    if any(DAGGER in line.method for block in grid.blocks for line in block) or any(cell.mark for cell in cells):
        text += f" {DAGGER} on part of the sequence."
    if any(cell.text == CROSS for cell in cells):
        text += f" {CROSS} out of memory."
    if any(cell.text == "n/r" for cell in cells):
        text += " n/r: not reported."
    if (
        columns_of != "paper"
        and filled.cells
        and any(metric.path.startswith("views.left.") for metric in filled.table.metrics)
    ):
        text += f" Our image and depth metrics are of {VIEW_GROUPS[views]}."
    return text


def _withheld(filled: FilledTable) -> list[str]:
    return [f"{name}: {facts.withheld}." for name, facts in filled.facts.items() if facts.withheld]


# From how many rows on a note says "all", and how many it then excepts.
_FEW_ROWS, _EXCEPTED = 3, 2


def _listed(rows: Sequence[str], of: Sequence[str]) -> str:
    """The rows by name, or which of all they are not."""
    others = [row for row in of if row not in rows]
    if len(rows) <= _FEW_ROWS or len(others) > _EXCEPTED:
        return ", ".join(rows)
    return f"all rows of ours but {', '.join(others)}" if others else "all rows of ours"


def _parts(filled: FilledTable) -> list[str]:
    """Which cells are of part of a sequence, and of how much."""
    by_amount: dict[tuple[str, int], list[str]] = defaultdict(list)
    of_sequence: dict[str, list[str]] = defaultdict(list)
    for (row, sequence), cell in filled.cells.items():
        of_sequence[sequence] += [row] if cell.shown else []
        if cell.is_part:
            by_amount[sequence, cell.frames].append(row)
    return [
        f"{DAGGER} {frames} of {filled.facts[name].frames} frames of {name}: {_listed(rows, of_sequence[name])}."
        for (name, frames), rows in by_amount.items()
    ]


def _weak_or_lost(filled: FilledTable) -> list[str]:
    """Of which runs frames were tracked weakly, by prediction alone or not at all, or that it was none."""
    found, known = [], False
    for where, run in _shown_runs(filled):
        frames = run.part("frames")
        count = {state: n for state in ("weak", "predicted", "lost") if isinstance(n := frames.get(state), int)}
        if "weak" in count and "lost" in count:
            known = True
            words = ", ".join(f"{n} {state}" for state, n in count.items() if n or state != "predicted")
            found += [f"{where}: {words} of {run.frames}"] if any(count.values()) else []
    if not known:
        return []
    return [f"Frames that were tracked weakly, or lost: {'; '.join(found) or 'none'}."]


def _protocols(filled: FilledTable) -> list[str]:
    """Which of our cells were scored under another protocol than the table's, or that none was."""
    if not filled.protocol:
        return []
    cells: dict[str, list[str]] = defaultdict(list)
    for (row, sequence), cell in filled.cells.items():
        if cell.shown:
            cells[cell.settings.get("protocol.name", "unknown")].append(f"{row} {sequence}")
    if set(cells) <= {filled.protocol}:
        return [f"Our numbers are by protocol {filled.protocol}."] if cells else []
    if len(cells) == 1:
        return [f"All our numbers are by protocol {name}, not {filled.protocol}." for name in cells]
    others = ((name, places) for name, places in sorted(cells.items()) if name != filled.protocol)
    return [f"By protocol {name}, not {filled.protocol}: {', '.join(places)}." for name, places in others]


def _settings(filled: FilledTable) -> list[str]:
    """One line for each set of settings, with the methods that used it."""
    users: dict[str, list[str]] = defaultdict(list)
    for (row, _), cell in filled.cells.items():
        seeds = ", ".join(str(run.seed) for run in cell.shown)
        has = cell.settings
        said = [(has[key], title) for key, title in _STATED if key in has and has[key] != _UNSAID.get(key)]
        parts = [f"{title} {value or 'all'}" for value, title in said]
        text = "; ".join([*parts, f"seeds {seeds or 'none'}"])
        if row not in users[text]:
            users[text].append(row)
    known = list(dict.fromkeys(row for row, _ in filled.cells))
    return [f"Settings of {_listed(rows, known)}: {text}." for text, rows in users.items()]


def _fewer_iterations(filled: FilledTable) -> list[str]:
    """Of which rows the runs had fewer iterations than their method has."""
    found: dict[str, None] = {}
    for row in filled.table.rows:
        whole = dict(each.split("=", 1) for each in row.iterations)
        for cell in (cell for (label, _), cell in filled.cells.items() if label == row.label and cell.shown):
            had = {key: cell.settings.get(key, "") for key in whole}
            fewer = [f"{key} {had[key]} of {whole[key]}" for key in whole if _count(had[key]) < _count(whole[key])]
            if fewer:
                found[f"{row.label} was run with fewer iterations than the method has: {', '.join(fewer)}."] = None
    return list(found)


def _count(iterations: str) -> float:
    return int(iterations) if iterations.isdecimal() else math.inf


def _external(filled: FilledTable) -> list[str]:
    """Which rows are scores of what other systems wrote."""
    rows = dict.fromkeys(row for (row, _), cell in filled.cells.items() if "foreign.name" in cell.settings)
    return [f"Scored here from the systems' own output: {', '.join(rows)}."] if rows else []


def _shown_runs(filled: FilledTable) -> list[tuple[str, RunRecord]]:
    return [
        (f"{row} {sequence} seed {run.seed}", run)
        for (row, sequence), cell in filled.cells.items()
        for run in cell.shown
    ]


def _about_published(table: NamedTable, published: PublishedNumbers, grid: Grid) -> list[str]:
    """The notes in the CSV files, the numbers that have no place in the table, and where references come from."""
    found = []
    remarks: dict[tuple[str, str], None] = {}
    for value in published.paper:
        if value.note:
            where = "" if table.across == "metrics" else f", {_titles(table).get(value.metric, value.metric)}"
            remarks[f"{value.method}{where}{', average' if value.sequence == AVERAGE else ''}", value.note] = None
    found += [f"The paper's {where}: {note}." for where, note in remarks]
    shown = {line.method.rstrip(DAGGER) for block in grid.blocks for line in block}
    sources: dict[str, dict[str, None]] = defaultdict(dict)
    for value in published.references:
        has_place = value.metric in _titles(table) and value.sequence in (*table.sequences, AVERAGE)
        if value.method in shown and has_place:
            text = value.method
            if value.note:
                where = f"{AVERAGE}: " if value.sequence == AVERAGE else ""
                found.append(f"{value.method}, {where}{value.note}.")
        else:
            text = f"{value.method} {value.value} {value.unit} ({_where(value)})"
        sources[value.source][text] = None
    return found + [f"{'; '.join(texts)}: {source}." for source, texts in sources.items()]


def _where(value: PublishedValue) -> str:
    parts = [f"sequence {value.sequence}" if value.sequence else value.dataset, *([value.note] if value.note else [])]
    return ", ".join(parts)


def _titles(table: NamedTable) -> dict[str, str]:
    return {metric.key: metric.title for metric in table.metrics}
