"""What ``bgs-bench run -m`` runs: every combination of the values given, for each cell of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bench.config import check_overrides, combinations, with_home
from bench.errors import BenchError
from bench.runs.config_file import RUNS_FOLDER
from bench.sweeps.experiment import expand_experiment
from bench.sweeps.plan import Plan, PlannedRun, compose_cell, quoted, sharing
from bench.tables.named.definitions import Cell


def plan_combinations(overrides: Sequence[str]) -> Plan:
    """Compose every combination, so that a wrong value is known before the first run starts; each is run once.

    ``output=`` names the folder that gets the run folders. Raises ``BenchError`` for wrong overrides.
    """
    runs: dict[Path, PlannedRun] = {}
    for cell, of_cell in expand_experiment(with_home(overrides)):
        swept = [o.get_key_element() for o in check_overrides(of_cell) if o.is_sweep_override()]
        for combination in combinations(of_cell):
            planned = _planned(cell, combination, swept)
            runs.setdefault(planned.folder.absolute(), planned)
    first = next(iter(runs.values()))
    return Plan(tuple(runs.values()), (), first.folder.parent)


def _planned(cell: Cell, combination: list[str], swept: Sequence[str]) -> PlannedRun:
    config = compose_cell(cell, combination)
    folder = Path(config.values["output"] or RUNS_FOLDER) / config.hash
    keys = [each.partition("=")[0] for each in combination]
    own = [each for each, key in zip(combination, keys, strict=True) if key in swept and key not in ("seed", "output")]
    kept = [each for each, key in zip(combination, keys, strict=True) if key.lstrip("+") != "output"]
    label = ", ".join([*([cell.row] if cell.row else []), *own])
    overrides = sharing([*kept, f"output={quoted(folder)}"])
    return PlannedRun(replace(cell, row=label), config.values["seed"], config, folder, overrides, 0)


def require_writable(root: Path) -> None:
    """Make the folder of the run folders, here, where the error is one line; raises ``BenchError``."""
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(
            f"Can't make the folder {root}: {error.strerror}. Give output= a place that you may write to."
        ) from error
