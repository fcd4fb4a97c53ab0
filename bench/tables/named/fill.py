"""Runs become the cells of a named table: which runs a cell shows, and what their numbers come to."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.runs.config_file import NO_PART_OF_THE_RUN
from bench.tables.named.definitions import Metric, NamedTable
from bench.tables.named.overrides import row_of
from bench.tables.named.published import SequenceFacts, read_sequences
from bench.tables.named.records import RunRecord

Place = tuple[str, str]
"""A row's label and a sequence."""
Settings = dict[str, str]
"""Dotted names of a config's values, and the values as text."""

# What may differ between runs whose numbers are averaged or compared: keys, and whole parts of the config.
_FREE = {"seed", "dataset.sequence", "dataset.root"}
_FREE_PARTS = (*NO_PART_OF_THE_RUN, "evaluator")
# Choosing a system chooses these too.
_OF_A_SYSTEM = ("mapper", "loss")


@dataclass(frozen=True)
class Statistic:
    """Mean over ``n`` runs; ``std`` is the sample standard deviation, None for a single run."""

    mean: float
    std: float | None
    n: int


@dataclass(frozen=True)
class FilledCell:
    """``shown`` are scored runs that differ in their seed alone and got through the same frames; ``state`` says in a
    word why there are none, but ``without_numbers``. ``is_part``: not the whole sequence. ``settings``: of the runs."""

    shown: tuple[RunRecord, ...]
    state: str
    is_part: bool
    settings: Settings
    notes: tuple[str, ...] = ()
    without_numbers: tuple[RunRecord, ...] = ()

    @property
    def frames(self) -> int:
        """How many frames the shown runs got through."""
        return self.shown[0].frames if self.shown else 0

    def values(self, metric: Metric) -> dict[int, float]:
        """The metric by seed, of the runs that have it and may count."""
        return {
            run.seed: run.values[metric.key]
            for run in self.shown
            if metric.key in run.values and (metric.of_part or run.state == "done")
        }

    def statistic(self, metric: Metric) -> Statistic | None:
        """The metric over the shown runs, or None where none has it."""
        return statistic(list(self.values(metric).values()))


@dataclass(frozen=True)
class FilledTable:
    """A table's definition, what the paper says of its sequences, and its cells that have runs.

    ``left_out`` counts runs of this data set that belong to no cell.
    """

    table: NamedTable
    facts: Mapping[str, SequenceFacts]
    cells: Mapping[Place, FilledCell]
    left_out: int

    def average(self, row: str, metric: Metric) -> Statistic | None:
        """Over all sequences, or None where one lacks the metric.

        The spread is that of each seed's average, where all sequences have the same seeds.
        """
        by_sequence = []
        for sequence in self.table.sequences:
            cell = self.cells.get((row, sequence))
            values = cell.values(metric) if cell is not None else {}
            if not values:
                return None
            by_sequence.append(values)
        if all(values.keys() == by_sequence[0].keys() for values in by_sequence):
            return statistic([float(np.mean([values[seed] for values in by_sequence])) for seed in by_sequence[0]])
        means = [float(np.mean(list(values.values()))) for values in by_sequence]
        return Statistic(float(np.mean(means)), None, min(len(values) for values in by_sequence))


def statistic(values: Sequence[float]) -> Statistic | None:
    """Mean and sample standard deviation of a metric, or None without values."""
    if not values:
        return None
    std = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return Statistic(float(np.mean(values)), std, len(values))


def fill(table: NamedTable, records: Sequence[RunRecord]) -> FilledTable:
    """Sort runs into the table's cells and choose what each cell shows.

    Where a cell has runs of several settings, those count under which most frames of the table were scored.
    """
    facts = read_sequences(table.dataset)
    found: dict[Place, list[tuple[RunRecord, Settings]]] = defaultdict(list)
    left_out = 0
    for record in records:
        place = row_of(table, record.config)
        if place is not None:
            found[place].append((record, settings_of(record.config)))
        elif _name_of(record.config.get("dataset")) == table.dataset:
            left_out += 1
    varied = varied_parts(table)
    ranks = _ranks(found, varied)
    cells = {}
    for row in table.rows:
        for sequence in table.sequences:
            if runs := found.get((row.label, sequence)):
                cells[row.label, sequence] = _fill_cell(runs, facts[sequence], varied, ranks)
    return FilledTable(table, facts, cells, left_out)


def settings_of(config: Mapping[str, Any]) -> Settings:
    """All that can change the result, by dotted name, except the seed and which sequence it is."""
    return {key: str(value) for key, value in _flat(config, "") if key not in _FREE}


def varied_parts(table: NamedTable) -> set[str]:
    """The parts of a config ("loss", "stereo", ...) in which the table's rows differ by intention."""
    overrides = [row.overrides for row in table.rows if row.overrides is not None]
    everywhere = set(overrides[0]).intersection(*overrides) if overrides else set()
    parts = {each.split("=")[0].split(".")[0] for of_row in overrides for each in set(of_row) - everywhere}
    return parts | set(_OF_A_SYSTEM) if "system" in parts else parts


def common(settings: Settings, varied: Iterable[str]) -> str:
    """The settings that all rows of a table should share, as one string."""
    parts = set(varied)
    return json.dumps({key: value for key, value in sorted(settings.items()) if key.split(".")[0] not in parts})


def _ranks(found: Mapping[Place, list[tuple[RunRecord, Settings]]], varied: set[str]) -> dict[str, int]:
    """Order of preference of the common settings: most frames scored over the cells, then most runs."""
    frames: dict[str, dict[Place, int]] = defaultdict(dict)
    runs: dict[str, int] = defaultdict(int)
    for place, members in found.items():
        for record, settings in members:
            key = common(settings, varied)
            scored = record.frames if record.values else 0
            frames[key][place] = max(scored, frames[key].get(place, 0))
            runs[key] += 1
    ordered = sorted(runs, key=lambda key: (-sum(frames[key].values()), -runs[key], key))
    return {key: rank for rank, key in enumerate(ordered)}


def _fill_cell(
    runs: list[tuple[RunRecord, Settings]], facts: SequenceFacts, varied: set[str], ranks: Mapping[str, int]
) -> FilledCell:
    variants: dict[str, list[RunRecord]] = defaultdict(list)
    settings_by_key: dict[str, Settings] = {}
    for record, settings in runs:
        key = json.dumps(settings, sort_keys=True)
        variants[key].append(record)
        settings_by_key[key] = settings

    def preference(key: str) -> tuple[bool, int, int, int, str]:
        scored = [record for record in variants[key] if record.values]
        most_frames = max((record.frames for record in scored), default=0)
        return not scored, ranks[common(settings_by_key[key], varied)], -most_frames, -len(scored), key

    best, *others = sorted(variants, key=preference)
    shown, notes = _choose_runs(variants[best])
    if others:
        left = sum(len(variants[key]) for key in others)
        differing = _differing([settings_by_key[key] for key in variants])
        notes.append(
            f"{left} {'run' if left == 1 else 'runs'} with other settings ({_some(differing)}) not shown; "
            "name run folders to choose"
        )
    state = "" if shown else _state_of(variants[best])
    is_part = bool(shown) and facts.is_part(shown[0].frames)
    unscored = sorted((run for run in variants[best] if not run.values), key=lambda run: (run.seed, str(run.folder)))
    return FilledCell(tuple(shown), state, is_part, settings_by_key[best], tuple(notes), tuple(unscored))


def _choose_runs(runs: list[RunRecord]) -> tuple[list[RunRecord], list[str]]:
    """One scored run a seed, all over the same frames; and notes on the others."""
    scored = [run for run in runs if run.values]
    frames = max((run.frames for run in scored), default=0)
    by_seed: dict[int, RunRecord] = {}
    repeated: dict[int, int] = defaultdict(int)
    notes = []
    for run in sorted(runs, key=lambda run: (run.seed, run.state != "done", str(run.folder))):
        if run.values and run.frames == frames:
            by_seed.setdefault(run.seed, run)
            repeated[run.seed] += 1
        elif run.values:
            notes.append(f"seed {run.seed} left out: {run.state} after {run.frames} frames")
        else:
            notes.append(f"seed {run.seed}: {'not scored' if run.state == 'done' else run.state}{_because(run)}")
    notes += [
        f"seed {seed} was run {times} times; {by_seed[seed].folder.name} is shown"
        for seed, times in repeated.items()
        if times > 1
    ]
    notes += [
        f"seed {run.seed}: {run.state} after {run.frames} frames{_because(run)}"
        for run in by_seed.values()
        if run.state not in ("done", "no status")
    ]
    return [by_seed[seed] for seed in sorted(by_seed)], notes


def _because(run: RunRecord) -> str:
    return f" ({run.reason})" if run.reason else ""


def _state_of(runs: list[RunRecord]) -> str:
    """The state that a cell without numbers shows: what needs attention least comes last."""
    states = {run.state for run in runs}
    order = ("out of memory", "failed", "killed", "interrupted", "running")
    return next((state for state in order if state in states), "not scored")


def differences(filled: FilledTable) -> list[str]:
    """Settings in which cells differ that are compared, and should not: down a row of sequences, and between rows."""
    varied = varied_parts(filled.table)
    found: set[str] = set()
    for row in filled.table.rows:
        of_row = [cell.settings for (label, _), cell in filled.cells.items() if label == row.label]
        found.update(_differing(of_row))
    everywhere = [cell.settings for cell in filled.cells.values()]
    found.update(key for key in _differing(everywhere) if key.split(".")[0] not in varied)
    texts = []
    for key in sorted(found):
        values = sorted({cell.settings.get(key, "not set") for cell in filled.cells.values()})
        texts.append(f"{key} ({_some([value or 'empty' for value in values])})")
    return texts


def _differing(several: Sequence[Settings]) -> list[str]:
    keys = {key for settings in several for key in settings}
    return sorted(key for key in keys if len({settings.get(key) for settings in several}) > 1)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _name_of(part: Any) -> Any:
    return part.get("name") if isinstance(part, Mapping) else part


def _flat(config: Mapping[str, Any], prefix: str) -> Iterable[tuple[str, Any]]:
    for key, value in config.items():
        if not prefix and key in _FREE_PARTS:
            continue
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, float) and math.isfinite(value) and value == int(value):
            # 1 and 1.0 are one setting.
            yield f"{prefix}{key}", int(value)
        else:
            yield f"{prefix}{key}", value
