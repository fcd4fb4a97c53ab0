"""The numbers of a named table, ours and others', one per row with full digits: what its CSV file holds."""

from __future__ import annotations

from typing import Any

from bench.contracts.metric import Metric
from bench.tables.document.model import Data
from bench.tables.named.definitions import MethodRow
from bench.tables.named.fill import FilledTable, Statistic
from bench.tables.named.grid import OURS, PAPER, PublishedNumbers
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


def tidy_data(filled: FilledTable, published: PublishedNumbers, columns_of: str = "both") -> Data:
    """All numbers of a table. ``by`` is "ours", "paper" or "elsewhere".

    ``status`` of ours: "ok"; "dagger" = part of the sequence; "cross" = out of memory; another state of the runs in
    words; "" = not run. ``runs`` lead to the runs, in the order of ``seeds``. ``columns_of``: whose numbers.
    """
    table, rows = filled.table, list[dict[str, Any]]()
    if columns_of != "ours":
        rows += [_published_row(value, PAPER) for value in published.paper]
        rows += [_published_row(value, "elsewhere") for value in published.references]
    for row in table.rows if columns_of != "paper" else ():
        if row.overrides is None and not filled.has_runs(row.label):
            continue
        for metric in table.metrics:
            for sequence in table.sequences:
                rows.append(_our_row(filled, published, row, metric, sequence))
            if table.across == "sequences":
                paper = published.get(row.published or row.compared_with, metric.key, AVERAGE)
                start = _start(filled, row, metric, AVERAGE)
                rows.append(start | _number(filled.average(row.label, metric), paper))
    return Data(COLUMNS, rows)


def _published_row(value: PublishedValue, by: str) -> dict[str, str]:
    names = ("table", "method", "dataset", "sequence", "metric", "unit", "value", "status", "source")
    return {"by": by} | {name: getattr(value, name) for name in names}


def _start(filled: FilledTable, row: MethodRow, metric: Metric, sequence: str) -> dict[str, str]:
    table = filled.table
    start = {"table": table.name, "by": OURS, "method": row.label, "dataset": table.dataset, "sequence": sequence}
    return start | {"metric": metric.key, "unit": metric.unit}


def _our_row(
    filled: FilledTable, published: PublishedNumbers, row: MethodRow, metric: Metric, sequence: str
) -> dict[str, Any]:
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
            "frames": cell.frames if cell.shown else None,
            "frames_of_sequence": filled.facts[sequence].frames or None,
            "protocol": " ".join(sorted({str(run.protocol.get("name", "")) for run in cell.shown})),
            "runs": tuple(run.source for run in runs),
        }
    )


def _number(found: Statistic | None, paper: PublishedValue | None) -> dict[str, Any]:
    known: dict[str, Any] = {"paper": paper.value if paper is not None else None}
    if found is None:
        return known
    known |= {"value": found.mean, "std": found.std, "n": found.n}
    if paper is not None and paper.number is not None:
        known["difference"] = found.mean - paper.number
    return known
