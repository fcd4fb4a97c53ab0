"""The rows of a sweep: a column for each setting in which its runs differ, and runs that differ in the seed as one."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.registry import OBSERVERS, RUN_KINDS, SEVERAL_AT_ONCE
from bench.tables.collect import Column, Row
from bench.tables.records.record import RunRecord, is_number
from bench.tables.records.settings import Settings, scored_config, settings_of

STD = "_std"
"""End of the key under which a row keeps the spread of a number."""
SEEDS = Column("seeds", "Seeds")
COUNT = Column("n", "n", is_number=True)
# Settings that the columns of every table of runs show already.
_SHOWN = ("system", "dataset.name", "stereo.name", "tracker.name")
_TOLD = ("dataset", "system", "stereo", "tracker")
# What choosing a system chooses too.
_OF_A_SYSTEM = ("mapper", "loss")
# What is beyond is no number that anyone measured, nor NaN: it is shown as it is.
_LARGEST = 1e300
_WORDS = {"True": "true", "False": "false", "None": "null"}


@dataclass(frozen=True)
class GroupedRuns:
    """``rows`` of one run, or of several that differ in their seed alone; ``settings`` are the columns of what differs.

    ``has_groups``: some row is of several runs, its numbers being means with spreads under ``KEY_std``.
    """

    rows: tuple[Row, ...]
    settings: tuple[Column, ...]

    @property
    def has_groups(self) -> bool:
        """Whether some row is of several runs."""
        return any(len(row.runs) > 1 for row in self.rows)

    def label(self, row: Row) -> str:
        """What tells a row from the others: ``stereo=sgbm, mapper.iterations=3``; the run's name where nothing does."""
        differing = [key for key in _TOLD if len({each.values.get(key) for each in self.rows}) > 1]
        told = [*((key, key) for key in differing), *((column.key, column.title) for column in self.settings)]
        named = [f"{title}={row.values[key]}" for key, title in told if row.values.get(key) is not None]
        return ", ".join(named) or str(row.values["run"])

    def folders(self) -> list[tuple[str, tuple[tuple[str, Path], ...]]]:
        """Where the runs are: of each row its label, and the seed and the folder of each of its runs."""
        return [
            (self.label(row), tuple((str(run.seed), run.source) for run in row.runs)) for row in self.rows if row.runs
        ]


def group_runs(rows: Sequence[Row], average: bool = True) -> GroupedRuns:
    """Group the rows of single runs, in the order in which they first appear; each alone without ``average``.

    Runs are averaged that have all settings but the seed in common, ended alike after equally many frames, and whose
    seeds differ. A damaged run, and one without a config, stays alone.
    """
    settings = [_settings_of(row.runs[0]) if row.runs else {} for row in rows]
    found: dict[Any, list[int]] = {}
    for place, row in enumerate(rows):
        found.setdefault(_key(row, settings[place]) or place, []).append(place)
    groups: list[list[int]] = []
    for places in found.values():
        seeds = [rows[place].runs[0].seed for place in places if rows[place].runs]
        groups += [places] if average and len(set(seeds)) == len(places) else [[place] for place in places]
    groups.sort()
    keys = _varied([each for each in settings if each])
    made = []
    for places in groups:
        values = {key: settings[places[0]].get(key) for key in keys}
        row = _mean_of([rows[place] for place in places])
        made.append(replace(row, values=row.values | values))
    return GroupedRuns(tuple(made), tuple(_column(key, made) for key in keys))


def by_settings(rows: Sequence[Row]) -> list[Row]:
    """The rows in the order of the settings in which they differ, numbers by size; other rows stay where they are."""
    settings = [_settings_of(row.runs[0]) if row.runs else {} for row in rows]
    keys = _varied([each for each in settings if each])

    def order(place: int) -> list[tuple[bool, float, str]]:
        values = (settings[place].get(key, "") for key in keys)
        return [(False, float(text), "") if _looks_like_number(text) else (True, 0.0, text) for text in values]

    return [rows[place] for place in sorted(range(len(rows)), key=order)]


def _key(row: Row, settings: Settings) -> Any:
    if not settings or row.runs[0].damage:
        return None
    run = row.runs[0]
    return (run.dataset, run.state, run.frames_done, tuple(sorted(settings.items())))


def _settings_of(run: RunRecord) -> Settings:
    """The run's settings as one types them; of several plugins of a kind, which there are."""
    found = {key: _WORDS.get(value, value) for key, value in settings_of(scored_config(run)).items()}
    for kind in SEVERAL_AT_ONCE:
        part = run.config.get(kind)
        if isinstance(part, Mapping) and kind not in ("evaluator", *OBSERVERS):
            found = {
                key: value for key, value in found.items() if (key.split(".")[0], key.split(".")[-1]) != (kind, "name")
            }
            found[kind] = f"[{','.join(sorted(map(str, part)))}]"
    return found


def _varied(several: Sequence[Settings]) -> list[str]:
    """The settings with several values among the runs that have them, but those that follow from another's choice."""
    keys = dict.fromkeys(key for settings in several for key in settings)
    differing = [key for key in keys if len({settings[key] for settings in several if key in settings}) > 1]
    choosers = {kind: [f"{kind}.name"] for kind in RUN_KINDS}
    for part in _OF_A_SYSTEM:
        choosers[part] = [*choosers[part], "system"]

    def follows(key: str) -> bool:
        of_part = choosers.get(key.partition(".")[0], [])
        return any(
            chooser in differing and chooser != key and _is_function(several, chooser, key) for chooser in of_part
        )

    return [key for key in differing if key not in _SHOWN and not follows(key)]


def _is_function(several: Sequence[Settings], chooser: str, key: str) -> bool:
    """Whether runs with one value of ``chooser`` have one value of ``key``."""
    pairs = {(settings.get(chooser), settings[key]) for settings in several if key in settings}
    return len(pairs) == len({chosen for chosen, _ in pairs})


def _column(key: str, rows: Sequence[Row]) -> Column:
    known = [row.values[key] for row in rows if row.values[key] is not None]
    return Column(key, key.removesuffix(".name"), is_number=all(_looks_like_number(value) for value in known))


def _looks_like_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _mean_of(rows: Sequence[Row]) -> Row:
    """One row: means and sample standard deviations of numbers, the different texts of others."""
    first = rows[0]
    ordered = sorted(rows, key=lambda row: row.runs[0].seed if row.runs else 0)
    runs = tuple(run for row in ordered for run in row.runs)
    if len(rows) == 1:
        return replace(first, values=first.values | ({"n": 1, "seeds": str(runs[0].seed)} if runs else {}))
    values: dict[str, Any] = {}
    for key in first.values:
        known = [row.values[key] for row in ordered if row.values.get(key) is not None]
        if known and all(is_number(value) and abs(value) < _LARGEST for value in known):
            same = len(set(known)) == 1
            values[key] = known[0] if same else statistics.fmean(known)
            values[f"{key}{STD}"] = statistics.stdev(known) if len(known) > 1 else None
        else:
            values[key] = " / ".join(dict.fromkeys(str(value) for value in known)) or None
    values |= {"n": len(rows), "seeds": " ".join(str(run.seed) for run in runs)}
    values["run"] = " ".join(run.name for run in runs)
    return replace(first, values=values, runs=runs)
