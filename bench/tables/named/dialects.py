"""The table of dialects: the numbers of runs by our protocol, and by the rules of other systems' evaluators."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.contracts.metric import Metric
from bench.evaluation.metrics import declared_metrics
from bench.tables.collect import Row
from bench.tables.document.model import UNKNOWN, Cell, Column, Data
from bench.tables.named.fill import Statistic, choose_runs, statistic
from bench.tables.named.grid import OURS, Grid, Line, heading, signed, statistic_cell
from bench.tables.records.made import made_in_words
from bench.tables.records.record import VIEW_GROUPS, RunRecord, is_number
from bench.tables.records.settings import scored_config, settings_of
from bench.tables.render import footnotes

METRICS = ("psnr_db", "ssim", "lpips", "depth_l1_cm", "ate_rmse_m")
CSV_COLUMNS = ("of", "by", "n_views", "metric", "unit", "value", "std", "n", "seeds", "difference", "runs")
_LEGEND = (
    "Line ours: mean ± sample standard deviation over seeds (number of runs), by the runs' protocol, of {views}. Lines "
    "below it: the same saved runs by the rules of other systems' evaluators, and in brackets their number minus ours."
)


@dataclass(frozen=True)
class ScoredGroup:
    """Runs of one system on one sequence that differ in their seed alone, all scored by the same dialects.

    ``notes`` are on runs that are not among them.
    """

    name: str
    runs: tuple[RunRecord, ...]
    notes: tuple[str, ...] = ()

    @property
    def dialects(self) -> Mapping[str, Mapping[str, Any]]:
        """The part ``dialects`` of the first run's metrics: by name, metrics, n_views and stamp."""
        return self.runs[0].part("dialects")

    def values(self, by: str, metric: Metric) -> dict[int, float]:
        """A number of ours or of a dialect by seed, of the runs that have it."""
        found = {}
        # Not every evaluator's ATE is a root mean square.
        key = "ate_m" if metric.key == "ate_rmse_m" and by != OURS else metric.key
        for run in self.runs:
            value = run.values.get(key) if by == OURS else run.part("dialects")[by].get(key)
            if value is not None and is_number(value):
                found[run.seed] = value
        return found

    def mean(self, by: str, metric: Metric) -> Statistic | None:
        """Over the runs that have it, or None."""
        return statistic(list(self.values(by, metric).values()))

    def difference(self, by: str, metric: Metric) -> float | None:
        """A dialect's number minus ours, the mean over the runs that have both; None without one."""
        ours, theirs = self.values(OURS, metric), self.values(by, metric)
        found = statistic([theirs[seed] - ours[seed] for seed in theirs if seed in ours])
        return None if by == OURS or found is None else found.mean

    def views(self, by: str) -> str:
        """How many views a dialect scored; several numbers where that differs between seeds."""
        counts = [str(run.part("dialects")[by].get("n_views")) for run in self.runs]
        return counts[0] if len(set(counts)) == 1 else "/".join(counts)


def scored_groups(records: Sequence[RunRecord]) -> list[ScoredGroup]:
    """The runs that the evaluator ``dialects`` has scored, grouped by all that is not their seed, and named."""
    groups: dict[str, list[RunRecord]] = defaultdict(list)
    settings: dict[str, dict[str, str]] = {}
    for record in records:
        dialects = record.part("dialects")
        if not dialects or not record.is_scored:
            continue
        of_run = settings_of(scored_config(record))
        stamps = {by: dialect.get("stamp") for by, dialect in dialects.items()}
        key = json.dumps([_plain_name(record), of_run, stamps], sort_keys=True)
        groups[key].append(record)
        settings[key] = of_run
    found = []
    for key, runs in sorted(groups.items()):
        shown, notes = choose_runs(runs)
        name = _plain_name(runs[0])
        alike = [settings[other] for other, members in groups.items() if _plain_name(members[0]) == name]
        found.append(ScoredGroup(name + _told_apart(settings[key], alike), tuple(shown), tuple(notes)))
    return found


def _plain_name(run: RunRecord) -> str:
    """System, data set and sequence."""
    return " ".join(part for part in (run.system, *(run.dataset or "").split("/", 1)) if part)


def _told_apart(settings: Mapping[str, str], alike: Sequence[Mapping[str, str]]) -> str:
    """The settings in which a group differs from those of the same name, in brackets."""
    keys = sorted({key for others in alike for key in (*others, *settings) if others.get(key) != settings.get(key)})
    parts = {key.removesuffix(".name") for key in keys if key.endswith(".name")}
    # What follows from another choice (a plugin's settings from its name) says nothing new.
    told = [key for key in keys if key.endswith(".name") or key.partition(".")[0] not in parts]
    shown = ", ".join(f"{key.removesuffix('.name')} {settings.get(key, 'not set') or 'all'}" for key in told)
    return f" ({shown})" if shown else ""


def dialect_grid(name: str, groups: Sequence[ScoredGroup]) -> Grid:
    """A block per group: ours, then one line per dialect with its difference to ours."""
    blocks = tuple(tuple(_line(group, by) for by in (OURS, *group.dialects)) for group in groups)
    title = "The same runs by the rules of other systems' evaluators"
    columns = tuple(Column(heading(metric), align="right") for metric in _metrics())
    return Grid(name, title, columns, blocks, has_metric_column=False)


def dialect_notes(groups: Sequence[ScoredGroup], not_scored: int, views: str, problems: Sequence[str]) -> list[str]:
    """How to read the table, the rules of each dialect, our protocol, and why numbers are missing."""
    notes = [_LEGEND.format(views=VIEW_GROUPS[views])]
    users: dict[str, list[str]] = {}
    for group in groups:
        for by, dialect in group.dialects.items():
            users.setdefault(f"Rules of {by}: {_in_words(dialect.get('stamp'))}.", []).append(group.name)
    # Runs that were scored alike share a line; the names stand there only where they were not.
    by_dialect = [rules.partition(":")[0] for rules in users]
    for rules, names in users.items():
        alone = by_dialect.count(rules.partition(":")[0]) == 1
        notes.append(rules if alone else f"{', '.join(names)}: {rules}")
    for group in groups:
        counts = ", ".join(f"{by} {group.views(by)}" for by in group.dialects)
        seeds = ", ".join(str(run.seed) for run in group.runs)
        notes.append(f"{group.name}: {group.runs[0].frames} frames; seeds {seeds}; views scored: {counts}.")
        notes += [f"{group.name}: {note}." for note in group.notes]
    if made := made_in_words([run for group in groups for run in group.runs]):
        notes.append(f"Made {'; '.join(made)}.")
    of_runs = ((f"{group.name}, seed {run.seed}", run) for group in groups for run in group.runs)
    notes += footnotes([Row({"run": name}, dict(run.protocol), run.notes) for name, run in of_runs])
    how = "add the evaluator 'dialects' to evaluator=[...] of the run"
    if not groups:
        notes.append(f"No run here was scored by dialects; {how}.")
    elif not_scored:
        count = "1 run was" if not_scored == 1 else f"{not_scored} runs were"
        notes.append(f"{count} not scored by dialects; {how}.")
    return notes + [f"Not read: {problem}" for problem in problems]


def _metrics() -> list[Metric]:
    known = {metric.key: metric for metric in declared_metrics()}
    return [known[key] for key in METRICS]


def _in_words(stamp: Any) -> str:
    """A dialect's rules; checksums stay in ``metrics.json``."""
    rules = stamp.items() if isinstance(stamp, dict) else ()
    return "; ".join(f"{key}: {value}" for key, value in rules if not key.endswith("sha256")) or "not known"


def dialect_data(groups: Sequence[ScoredGroup]) -> Data:
    """One row per number; ``runs`` lead to the runs, in the order of ``seeds``."""
    rows = []
    for group in groups:
        for by in (OURS, *group.dialects):
            for metric in _metrics():
                found = group.mean(by, metric)
                row: dict[str, Any] = {"of": group.name, "by": by, "metric": metric.key, "unit": metric.unit}
                row |= {} if by == OURS else {"n_views": group.views(by)}
                row |= {} if found is None else {"value": found.mean, "n": found.n, "std": found.std}
                row["difference"] = group.difference(by, metric)
                row["seeds"] = " ".join(str(run.seed) for run in group.runs)
                rows.append(row | {"runs": tuple(run.source for run in group.runs)})
    return Data(CSV_COLUMNS, rows)


def _line(group: ScoredGroup, by: str) -> Line:
    return Line(by, group.name, None, tuple(_cell(group, by, metric) for metric in _metrics()))


def _cell(group: ScoredGroup, by: str, metric: Metric) -> Cell:
    found, difference = group.mean(by, metric), group.difference(by, metric)
    if found is None:
        return Cell(UNKNOWN)
    cell = statistic_cell(found, metric)
    text = cell.text + ("" if difference is None else f" ({signed(difference, metric.decimals or 0)})")
    links = tuple((str(run.seed), run.source) for run in group.runs) if by == OURS else ()
    # The number of runs stands on our line, and where a dialect could score fewer.
    return replace(cell, text=text, n=found.n if by == OURS or found.n < len(group.runs) else 0, links=links)
