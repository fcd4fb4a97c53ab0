"""The table of dialects: a run's numbers by our protocol, and by the rules of other systems' evaluators."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.runs.folder import METRICS_FILE
from bench.runs.status import read_json
from bench.tables.collect import Row
from bench.tables.named.definitions import ATE, IMAGE, Metric
from bench.tables.named.grid import MINUS, OURS, Grid, GridCell, Line, heading
from bench.tables.named.links import relative
from bench.tables.named.records import RunRecord
from bench.tables.render import UNKNOWN, footnotes

METRICS = (*IMAGE, ATE)
CSV_COLUMNS = ("run", "by", "n_views", "metric", "unit", "value", "difference", "folder")
_LEGEND = (
    "Line ours: by the run's protocol, of {views}. Lines below it: the same saved run by the rules of other systems' "
    "evaluators, and in brackets their number minus ours."
)
_VIEWS = {
    "left": "all left views",
    "heldout": "left views that mapping never saw",
    "right": "right views",
}


@dataclass(frozen=True)
class ScoredRun:
    """A run and its part ``dialects`` of ``metrics.json``: by name, metrics, n_views and stamp."""

    record: RunRecord
    dialects: Mapping[str, Mapping[str, Any]]

    @property
    def name(self) -> str:
        """How the table calls it."""
        return self.record.folder.resolve().name

    def value(self, by: str, metric: Metric) -> float | None:
        """A number of ours or of a dialect, or None."""
        # Not every evaluator's ATE is a root mean square.
        key = "ate_m" if metric is ATE and by != OURS else metric.key
        found = self.record.values.get(key) if by == OURS else self.dialects[by].get(key)
        return found if isinstance(found, (int, float)) else None

    def difference(self, by: str, metric: Metric) -> float | None:
        """A dialect's number minus ours, where both are known."""
        ours, theirs = self.value(OURS, metric), self.value(by, metric)
        return None if by == OURS or ours is None or theirs is None else theirs - ours


def scored_runs(records: Sequence[RunRecord]) -> list[ScoredRun]:
    """The runs that the evaluator ``dialects`` has scored; raises ``BenchError`` for a damaged ``metrics.json``."""
    runs = []
    for record in records:
        path = record.folder / METRICS_FILE
        dialects = read_json(path).get("dialects") if path.is_file() else None
        if isinstance(dialects, dict) and dialects:
            runs.append(ScoredRun(record, dialects))
    return runs


def dialect_grid(name: str, runs: Sequence[ScoredRun]) -> Grid:
    """A block a run: ours, then one line a dialect with its difference to ours."""
    blocks = tuple(tuple(_line(run, by) for by in (OURS, *run.dialects)) for run in runs)
    title = "The same runs by the rules of other systems' evaluators"
    return Grid(name, title, tuple(heading(metric) for metric in METRICS), blocks, has_metric_column=False)


def dialect_notes(runs: Sequence[ScoredRun], not_scored: int, views: str, problems: Sequence[str]) -> list[str]:
    """How to read the table, the rules of each dialect, our protocol, and why numbers are missing."""
    notes = [_LEGEND.format(views=_VIEWS[views])]
    users: dict[str, list[str]] = {}
    for run in runs:
        for by, dialect in run.dialects.items():
            users.setdefault(f"Rules of {by}: {_in_words(dialect.get('stamp'))}.", []).append(run.name)
    # Runs that were scored alike share a line; the names stand there only where they were not.
    by_dialect = [rules.partition(":")[0] for rules in users]
    for rules, names in users.items():
        alone = by_dialect.count(rules.partition(":")[0]) == 1
        notes.append(rules if alone else f"{', '.join(names)}: {rules}")
    for run in runs:
        counts = ", ".join(f"{by} {dialect.get('n_views')}" for by, dialect in run.dialects.items())
        notes.append(f"{run.name}: views scored: {counts}.")
    notes += footnotes([Row({"run": run.name}, dict(run.record.protocol), run.record.notes) for run in runs])
    how = "add the evaluator 'dialects' to evaluator=[...] of the run"
    if not runs:
        notes.append(f"No run here was scored by dialects; {how}.")
    elif not_scored:
        count = "1 run was" if not_scored == 1 else f"{not_scored} runs were"
        notes.append(f"{count} not scored by dialects; {how}.")
    return notes + [f"Not read: {problem}" for problem in problems]


def _in_words(stamp: Any) -> str:
    """A dialect's rules; checksums stay in ``metrics.json``."""
    rules = stamp.items() if isinstance(stamp, dict) else ()
    return "; ".join(f"{key}: {value}" for key, value in rules if not key.endswith("sha256")) or "not known"


def dialect_csv(runs: Sequence[ScoredRun], folder: Path) -> str:
    """One row a number with full digits, empty where not known; ``folder`` of a run is relative to ``folder``."""
    text = io.StringIO()
    writer = csv.DictWriter(text, CSV_COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for run in runs:
        for by in (OURS, *run.dialects):
            for metric in METRICS:
                value, difference = run.value(by, metric), run.difference(by, metric)
                row: dict[str, Any] = {"run": run.name, "by": by, "metric": metric.key, "unit": metric.unit}
                row |= {} if by == OURS else {"n_views": run.dialects[by].get("n_views")}
                row |= {} if value is None else {"value": repr(value)}
                row |= {} if difference is None else {"difference": repr(difference)}
                writer.writerow(row | {"folder": relative(run.record.folder, folder)})
    return text.getvalue()


def _line(run: ScoredRun, by: str) -> Line:
    return Line(by, run.name, None, tuple(_cell(run, by, metric) for metric in METRICS))


def _cell(run: ScoredRun, by: str, metric: Metric) -> GridCell:
    value, difference = run.value(by, metric), run.difference(by, metric)
    if value is None:
        return GridCell(UNKNOWN)
    text = f"{value:.{metric.decimals}f}"
    if difference is not None:
        # No minus before a difference that rounds to 0.
        rounded = round(difference, metric.decimals) or 0.0
        text += f" ({rounded:+.{metric.decimals}f})".replace("-", MINUS)
    runs = ((run.record.seed, run.record.folder),) if by == OURS else ()
    return GridCell(text, value=value, runs=runs)
