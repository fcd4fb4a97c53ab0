"""A named table as tidy CSV: one row a number, ours and others', with full digits."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from bench.tables.named.definitions import MethodRow
from bench.tables.named.fill import FilledTable, Statistic
from bench.tables.named.grid import OURS, PAPER, PublishedNumbers
from bench.tables.named.links import relative
from bench.tables.named.metrics import Metric
from bench.tables.named.published import AVERAGE, PublishedValue

COLUMNS = (
    "table",
    "by",
    "method",
    "dataset",
    "sequence",
    "metric",
    "unit",
    "value",
    "std",
    "n",
    "seeds",
    "status",
    "frames",
    "frames_of_sequence",
    "paper",
    "difference",
    "protocol",
    "runs",
    "source",
)


def as_csv(filled: FilledTable, published: PublishedNumbers, folder: Path) -> str:
    """All numbers of a table; empty where not known. ``by`` is "ours", "paper" or "elsewhere".

    ``status`` of ours: "ok"; "dagger" = part of the sequence; "cross" = out of memory; another state of the runs in
    words; "" = not run. ``runs`` are paths relative to ``folder``, separated by blanks, in the order of ``seeds``.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for value in published.paper:
        writer.writerow(_published_row(value, PAPER))
    for value in published.references:
        writer.writerow(_published_row(value, "elsewhere"))
    table = filled.table
    for row in table.rows:
        if row.overrides is None and not filled.has_runs(row.label):
            continue
        for metric in table.metrics:
            for sequence in table.sequences:
                writer.writerow(_our_row(filled, published, row, metric, sequence, folder))
            if table.across == "sequences":
                paper = published.get(row.published or row.compared_with, metric.key, AVERAGE)
                start = _start(filled, row, metric, AVERAGE)
                writer.writerow(start | _number(filled.average(row.label, metric), paper))
    return text.getvalue()


def _published_row(value: PublishedValue, by: str) -> dict[str, str]:
    names = ("table", "method", "dataset", "sequence", "metric", "unit", "value", "status", "source")
    return {"by": by} | {name: getattr(value, name) for name in names}


def _start(filled: FilledTable, row: MethodRow, metric: Metric, sequence: str) -> dict[str, str]:
    table = filled.table
    start = {"table": table.name, "by": OURS, "method": row.label, "dataset": table.dataset, "sequence": sequence}
    return start | {"metric": metric.key, "unit": metric.unit}


def _our_row(
    filled: FilledTable, published: PublishedNumbers, row: MethodRow, metric: Metric, sequence: str, folder: Path
) -> dict[str, str]:
    paper = published.get(row.published or row.compared_with, metric.key, sequence)
    start = _start(filled, row, metric, sequence)
    cell = filled.cells.get((row.label, sequence))
    if cell is None:
        return start | _number(None, paper) | {"status": "withheld" if filled.facts[sequence].withheld else ""}
    runs = cell.shown or cell.without_numbers
    state = ("dagger" if cell.is_part else "ok") if cell.shown else cell.state
    found = cell.statistic(metric)
    return (
        start
        | _number(found, paper)
        | {
            "seeds": " ".join(str(run.seed) for run in runs),
            "status": "cross" if state == "out of memory" else state if found or not cell.shown else "not known",
            "frames": str(cell.frames) if cell.shown else "",
            "frames_of_sequence": str(filled.facts[sequence].frames or ""),
            "protocol": " ".join(sorted({str(run.protocol.get("name", "")) for run in cell.shown})),
            "runs": " ".join(relative(run.source, folder) for run in runs),
        }
    )


def _number(found: Statistic | None, paper: PublishedValue | None) -> dict[str, str]:
    known = {"paper": paper.value if paper is not None else ""}
    if found is None:
        return known
    known |= {"value": repr(found.mean), "std": "" if found.std is None else repr(found.std), "n": str(found.n)}
    if paper is not None and paper.number is not None:
        known["difference"] = repr(found.mean - paper.number)
    return known
