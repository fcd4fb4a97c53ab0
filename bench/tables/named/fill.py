"""Runs become the cells of a named table: which runs a cell shows, and what their numbers come to."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.contracts.metric import Metric
from bench.tables.named.definitions import NamedTable
from bench.tables.named.found_rows import with_found_rows
from bench.tables.named.overrides import row_of
from bench.tables.named.published import SequenceFacts
from bench.tables.named.settings import common, varied_parts
from bench.tables.records.record import RunRecord
from bench.tables.records.settings import Settings, differing_keys, first_few, scored_config, settings_of

Place = tuple[str, str]
"""A row's label and a sequence."""


@dataclass(frozen=True)
class Statistic:
    """Mean over ``n`` runs; ``std`` is the sample standard deviation, None for a single run."""

    mean: float
    std: float | None
    n: int


@dataclass(frozen=True)
class _Found:
    """A run of a cell, and the settings that its numbers were made under; ``key`` has them all."""

    record: RunRecord
    settings: Settings

    @cached_property
    def key(self) -> str:
        return json.dumps(self.settings, sort_keys=True)


@dataclass(frozen=True)
class _Preference:
    """Which settings a cell shows: ``ranks`` of the common ones, in how many cells of the row all were ``used``."""

    varied: set[str]
    ranks: Mapping[str, int]
    used: Mapping[str, int]
    protocol: str

    def __call__(self, runs: Sequence[_Found]) -> tuple[bool, bool, int, int, int, int, str]:
        """Sorts first what is to be shown, of runs that have their settings in common."""
        settings, key = runs[0].settings, runs[0].key
        scored = [run.record for run in runs if run.record.is_scored]
        most_frames = max((record.frames for record in scored), default=0)
        other_protocol = bool(self.protocol) and settings.get("protocol.name") != self.protocol
        rank = self.ranks[common(settings, self.varied)]
        return not scored, other_protocol, rank, -most_frames, -self.used[key], -len(scored), key


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

    ``left_out`` counts runs of this data set that belong to no cell. ``protocol`` is the one that was preferred, or
    empty.
    """

    table: NamedTable
    facts: Mapping[str, SequenceFacts]
    cells: Mapping[Place, FilledCell]
    left_out: int
    protocol: str = ""

    def has_runs(self, row: str) -> bool:
        """Whether a cell of the row with this label has runs."""
        return any((row, sequence) in self.cells for sequence in self.table.sequences)

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


def fill(table: NamedTable, records: Sequence[RunRecord], left_out: int = 0, protocol: str = "") -> FilledTable:
    """Sort runs into the table's cells and choose what each cell shows.

    A cell shows runs of one set of settings, the protocol among them, never a mixture: first those scored under
    ``protocol`` (a name; empty: any), then those under whose settings most frames of the table were scored.
    ``left_out`` counts runs that are known to belong to no cell and are not among the records.
    """
    table = with_found_rows(table, [record.config for record in records])
    facts = {sequence: table.facts_of(sequence) for sequence in table.sequences}
    found: dict[Place, list[_Found]] = defaultdict(list)
    for record in records:
        place = row_of(table, record.config)
        if place is not None:
            found[place].append(_Found(record, _compared_settings(table, record)))
        elif is_of(record, table):
            left_out += 1
    varied = varied_parts(table)
    ranks = _ranks(found, varied)
    cells = {}
    for row in table.rows:
        of_row = {
            sequence: found[row.label, sequence] for sequence in table.sequences if (row.label, sequence) in found
        }
        used = Counter(key for runs in of_row.values() for key in {run.key for run in runs})
        for sequence, runs in of_row.items():
            cells[row.label, sequence] = _fill_cell(runs, facts[sequence], _Preference(varied, ranks, used, protocol))
    return FilledTable(table, facts, cells, left_out, protocol)


def _compared_settings(table: NamedTable, record: RunRecord) -> Settings:
    """The run's settings without those that choose a column."""
    choosing = {override.partition("=")[0] for overrides in table.sequences.values() for override in overrides}
    return {key: value for key, value in settings_of(scored_config(record)).items() if key not in choosing}


def is_of(record: RunRecord, table: NamedTable) -> bool:
    """Whether the run is on the table's data set, in one of its cells or not."""
    return record.plugin("dataset") == table.dataset


def _ranks(found: Mapping[Place, list[_Found]], varied: set[str]) -> dict[str, int]:
    """Order of preference of the common settings: most frames scored over the cells, then most runs."""
    frames: dict[str, dict[Place, int]] = defaultdict(dict)
    runs: dict[str, int] = defaultdict(int)
    for place, members in found.items():
        for member in members:
            key = common(member.settings, varied)
            scored = member.record.frames if member.record.is_scored else 0
            frames[key][place] = max(scored, frames[key].get(place, 0))
            runs[key] += 1
    ordered = sorted(runs, key=lambda key: (-sum(frames[key].values()), -runs[key], key))
    return {key: rank for rank, key in enumerate(ordered)}


def _fill_cell(runs: list[_Found], facts: SequenceFacts, preference: _Preference) -> FilledCell:
    variants: dict[str, list[_Found]] = defaultdict(list)
    for run in runs:
        variants[run.key].append(run)
    best, *others = sorted(variants.values(), key=preference)
    records = [run.record for run in best]
    shown, notes = choose_runs(records)
    if others:
        left = sum(len(variant) for variant in others)
        differing = differing_keys([variant[0].settings for variant in variants.values()])
        notes.append(
            f"{left} {'run' if left == 1 else 'runs'} with other settings ({first_few(differing)}) not shown; "
            "name run folders to choose"
        )
    state = "" if shown else _state_of(records)
    is_part = bool(shown) and facts.is_part(shown[0].frames)
    unscored = sorted((run for run in records if not run.is_scored), key=lambda run: (run.seed, run.name))
    return FilledCell(tuple(shown), state, is_part, best[0].settings, tuple(notes), tuple(unscored))


def choose_runs(runs: list[RunRecord]) -> tuple[list[RunRecord], list[str]]:
    """Of runs that differ in their seed alone: one scored run a seed, all over the same frames; notes on the others."""
    scored = [run for run in runs if run.is_scored]
    frames = max((run.frames for run in scored), default=0)
    by_seed: dict[int, RunRecord] = {}
    repeated: dict[int, int] = defaultdict(int)
    notes = []
    for run in sorted(runs, key=lambda run: (run.seed, run.state != "done", run.name)):
        if run.is_scored and run.frames == frames:
            by_seed.setdefault(run.seed, run)
            repeated[run.seed] += 1
        elif run.is_scored:
            notes.append(f"seed {run.seed} left out: {run.state} after {run.frames} frames")
        else:
            notes.append(f"seed {run.seed}: {'not scored' if run.state == 'done' else run.state}{_because(run)}")
    notes += [
        f"seed {seed} was run {times} times; {by_seed[seed].name} is shown"
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


# These come with a mapper of another system.
_OF_A_FAMILY = ("tracker", "keyframer", "sky")


def differences(filled: FilledTable) -> list[str]:
    """Settings in which cells differ that are compared, and should not: down a row of sequences, and between rows;
    those of tracker, keyframer and sky between rows of the same mapper."""
    varied = varied_parts(filled.table)
    found: set[str] = set()
    for row in filled.table.rows:
        of_row = [cell.settings for (label, _), cell in filled.cells.items() if label == row.label]
        found.update(differing_keys(of_row))
    everywhere = [cell.settings for cell in filled.cells.values() if not _is_external(cell)]
    # Other systems share no more than the data and the protocol with ours.
    of_all = [_data_and_protocol(cell.settings) for cell in filled.cells.values()]
    found.update(differing_keys(of_all))
    found.update(key for key in differing_keys(everywhere) if key.split(".")[0] not in {*varied, *_OF_A_FAMILY})
    families: dict[str, list[Settings]] = defaultdict(list)
    for settings in everywhere:
        families[settings.get("mapper.name", "")].append(settings)
    for family in families.values():
        found.update(key for key in differing_keys(family) if key.split(".")[0] in {*_OF_A_FAMILY} - varied)
    texts = []
    for key in sorted(found):
        cells = [cell for cell in filled.cells.values() if key in cell.settings or not _is_external(cell)]
        values = sorted({cell.settings.get(key, "not set") for cell in cells})
        texts.append(f"{key} ({first_few([value or 'empty' for value in values])})")
    return texts


def _is_external(cell: FilledCell) -> bool:
    return "foreign.name" in cell.settings


def _data_and_protocol(settings: Settings) -> Settings:
    return {key: value for key, value in settings.items() if key.partition(".")[0] in ("dataset", "protocol")}
