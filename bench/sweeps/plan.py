"""What is to be run: each cell of a named table with its seeds, in the order that fills it soonest, or combinations."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from bench import registry
from bench.config import RunConfig, check_overrides, compose_run, resolved
from bench.errors import BenchError
from bench.installed_data import config_folder
from bench.override_text import hydra_lines, quoted
from bench.plugin_config import plugins_in
from bench.registry import RUN_KINDS, SEVERAL_AT_ONCE
from bench.runs.config_file import RUNS_FOLDER
from bench.sweeps.job import Job
from bench.tables.named.definitions import Cell, NamedTable, cells
from bench.tables.named.overrides import row_of


@dataclass(frozen=True)
class PlannedRun:
    """One run of a cell. ``overrides`` are those of ``bgs-bench run``; ``frames`` is how many the data set has, or 0.

    ``cell``: its place in a table, or what tells it from the others of the sweep.
    """

    cell: Cell
    seed: int
    config: RunConfig
    folder: Path
    overrides: tuple[str, ...]
    frames: int

    @property
    def label(self) -> str:
        """The run in words: row, sequence and seed."""
        return ", ".join(part for part in (self.cell.row, self.cell.column, f"seed {self.seed}") if part)

    @property
    def job(self) -> Job:
        """The run as the process that starts it gets it."""
        return Job(self.label, self.folder.absolute(), Path.cwd(), tuple(arguments_of(self)))


@dataclass(frozen=True)
class Skipped:
    """A cell that can't be run here, and why."""

    cell: Cell
    reason: str


@dataclass(frozen=True)
class Plan:
    """``runs`` in the order in which they are made; their folders lie in ``root``."""

    runs: tuple[PlannedRun, ...]
    skipped: tuple[Skipped, ...]
    root: Path


def arguments_of(planned: PlannedRun) -> list[str]:
    """What Python is given to make this run."""
    return ["-m", "bench.cli", "run", *planned.overrides]


def make_plan(table: NamedTable, overrides: Sequence[str], seeds: Sequence[int]) -> Plan:
    """Expand the table's cells by ``seeds``; ``overrides`` (Hydra syntax) hold for all cells but where a cell differs.

    Those of one plugin (``tracker.splatam.iterations=10``) hold for the cells that use it.
    The first seed of every cell comes first, and within a seed the sequences with the fewest frames. ``output=`` names
    the folder that gets the run folders. Raises ``BenchError`` for overrides that are wrong or that would take a run
    out of its cell, and where no cell can be run, with the reason of the first.
    """
    of_table = cells(table)
    common, root = _split_output(_checked(overrides, table.name, of_table))
    common, of_plugins = _split_plugins(common)
    runs: list[PlannedRun] = []
    skipped: list[Skipped] = []
    known: dict[str, int | str] = {}
    used: set[tuple[str, str, str]] = set()
    measuring = any(metric.unit in ("s/frame", "GB") for metric in table.metrics)
    for cell in of_table:
        reason = cell.blocked or _without_plugin(cell)
        if reason:
            skipped.append(Skipped(cell, reason))
            continue
        config = _compose(table, cell, common)
        of_cell = [each for each in of_plugins if config.plugin(each[0]).name == each[1]]
        used.update(of_cell)
        chosen = [*common, *(override for _, _, override in of_cell)]
        # A sequence that has no more frames than the cell's part is run whole.
        for tried in (cell, replace(cell, part=())) if cell.part else (cell,):
            config = _compose(table, tried, chosen) if of_cell or tried is not cell else config
            frames = _unavailable(config, known) or _frames(config, known)
            if not isinstance(frames, str):
                runs += [_planned(tried, seed, config, root, chosen, frames, measuring) for seed in seeds]
                break
        else:
            skipped.append(Skipped(cell, str(frames)))
    for kind, plugin, override in set(of_plugins) - used:
        given = override.replace(f"{kind}.", f"{kind}.{plugin}.", 1)
        raise BenchError(f"{given}: no row of {table.name} that can be run has {kind}={plugin}. Leave it out.")
    if not runs and skipped:
        raise BenchError(f"No cell of {table.name} can be run: {skipped[0].reason}")
    order = {seed: position for position, seed in enumerate(seeds)}
    # Stable: cells of one sequence stay in the table's order.
    runs.sort(key=lambda run: (order[run.seed], run.frames))
    return Plan(tuple(runs), tuple(skipped), root)


def _checked(overrides: Sequence[str], table: str, of_table: Sequence[Cell]) -> list[str]:
    """The user's overrides; raises ``BenchError`` for one that sweeps, or that every cell has its own value of."""
    everywhere = set.intersection(*({each.partition("=")[0] for each in cell.overrides} for cell in of_table))
    lines = hydra_lines(overrides)
    for parsed in check_overrides(lines):
        key = parsed.get_key_element()
        if parsed.is_sweep_override():
            raise BenchError(f"{parsed.input_line} names several values; a table's cells have one. Give one value.")
        if key == "seed":
            raise BenchError(f"{parsed.input_line}: a table wants several seeds; give them as --seeds 0,1,2.")
        if key in everywhere:
            raise BenchError(f"{parsed.input_line}: every cell of {table} has its own {key}. Leave it out.")
    return lines


def _split_output(overrides: list[str]) -> tuple[list[str], Path]:
    """The overrides without ``output=``, and the folder that it names (default ``results/runs``)."""
    root = RUNS_FOLDER
    rest = []
    for parsed in check_overrides(overrides):
        if parsed.get_key_element() == "output":
            root = Path(str(parsed.value()))
        else:
            rest.append(parsed.input_line or "")
    return rest, root


def _split_plugins(overrides: Sequence[str]) -> tuple[list[str], list[tuple[str, str, str]]]:
    """The overrides for all, and those of one plugin: its kind, its name, and ``kind.setting=value``."""
    of_all: list[str] = []
    of_plugins: list[tuple[str, str, str]] = []
    for each in overrides:
        kind, *names = each.partition("=")[0].split(".")
        if len(names) > 1 and kind not in SEVERAL_AT_ONCE and kind in RUN_KINDS and names[0] in registry.names(kind):
            of_plugins.append((kind, names[0], each.replace(f".{names[0]}.", ".", 1)))
        else:
            of_all.append(each)
    return of_all, of_plugins


def _without_plugin(cell: Cell) -> str:
    """Why the bench has no such plugin, or an empty string."""
    for override in cell.overrides:
        kind, _, name = override.partition("=")
        if kind in RUN_KINDS and kind not in SEVERAL_AT_ONCE and name not in registry.names(kind):
            preset = config_folder() / kind / f"{name}.yaml"
            if not preset.is_file():
                return f"there is no {kind} plugin '{name}'"
    return ""


def compose_cell(cell: Cell, overrides: Sequence[str]) -> RunConfig:
    """Compose a run of a cell; raises ``BenchError``, with the row's place where the row itself is wrong."""
    try:
        return compose_run(overrides)
    except BenchError as error:
        try:
            compose_run(cell.overrides_with(()))
        except BenchError as of_row:
            raise BenchError(f"{cell.source}: {of_row}") from of_row
        raise error


def _compose(table: NamedTable, cell: Cell, common: Sequence[str]) -> RunConfig:
    config = compose_cell(cell, cell.overrides_with(common))
    if row_of(table, config.values) != (cell.row, cell.column):
        raise BenchError(
            f"With {' '.join(common)} a run of '{cell.row}' would no longer be one of this row of {table.name}. "
            "Leave out what makes the difference."
        )
    return config


def _unavailable(config: RunConfig, known: dict[str, int | str]) -> str:
    """Why a plugin of the run can't work on this machine, or an empty string; asked once for each."""
    for kind, part in plugins_in(config.values):
        if kind in SEVERAL_AT_ONCE:
            continue
        name = part["name"]
        key = f"{kind}={name}"
        if key not in known:
            reason = registry.lookup(kind, name).unavailable_reason()
            known[key] = f"{key} can't run here: {reason}" if reason else ""
        if known[key]:
            return str(known[key])
    return ""


def _frames(config: RunConfig, known: dict[str, int | str]) -> int | str:
    """How many frames the run's data set has, or why it can't be opened; opened once."""
    key = json.dumps(config.values["dataset"], sort_keys=True, default=str)
    if key not in known:
        try:
            known[key] = len(registry.build(config.plugin("dataset"), "dataset"))
        except BenchError as error:
            known[key] = str(error)
    return known[key]


def sharing(overrides: Sequence[str], measuring: bool = False) -> tuple[str, ...]:
    """A run's overrides with ``cache.all=true``, so that a sweep's runs share tracking and stereo, unless they say.

    With ``measuring``, for a table of times or memory, each run computes everything itself.
    """
    key = "cache.enabled=" if measuring else "cache.all="
    if any(each.startswith(key) for each in overrides):
        return tuple(overrides)
    return (*overrides, f"{key}{'false' if measuring else 'true'}")


def _planned(
    cell: Cell, seed: int, config: RunConfig, root: Path, common: Sequence[str], frames: int, measuring: bool
) -> PlannedRun:
    values: dict[str, Any] = config.values | {"seed": seed}
    # Resolving plain values again takes a tenth of the time of composing them again.
    seeded = resolved(OmegaConf.create(values))
    folder = root / seeded.hash
    overrides = (*cell.overrides_with(common), f"seed={seed}", f"output={quoted(folder)}")
    return PlannedRun(cell, seed, seeded, folder, sharing(overrides, measuring), frames)
