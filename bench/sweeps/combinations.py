"""What ``bgs-bench run -m`` runs: every combination of the values given, for each cell of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hydra.core.override_parser.types import Glob, Override

from bench.config import check_overrides
from bench.errors import BenchError
from bench.hydra_settings import config_folders
from bench.override_text import hydra_lines, quoted
from bench.runs.config_file import RUNS_FOLDER
from bench.sweeps.experiment import EXPERIMENT, expand_experiment
from bench.sweeps.plan import Plan, PlannedRun, Skipped, compose_cell, sharing
from bench.swept_values import combinations, glob_choices
from bench.tables.named.definitions import Cell


def plan_combinations(overrides: Sequence[str]) -> Plan:
    """Compose every combination, so that a wrong value is known before the first run starts; each is run once.

    ``output=`` names the folder that gets the run folders. ``stereo=glob(*)`` is every backbone that can run here; the
    others are skipped. Raises ``BenchError`` for wrong overrides.
    """
    runs: dict[Path, PlannedRun] = {}
    given, skipped = expand_globs(hydra_lines(overrides))
    for cell, of_cell in expand_experiment(given):
        swept = [o.get_key_element() for o in check_overrides(of_cell) if o.is_sweep_override()]
        for combination in combinations(of_cell):
            planned = planned_run(cell, combination, swept)
            runs.setdefault(planned.folder.absolute(), planned)
    first = next(iter(runs.values()))
    return Plan(tuple(runs.values()), tuple(skipped), first.folder.parent)


def expand_globs(overrides: Sequence[str]) -> tuple[list[str], list[Skipped]]:
    """The overrides with the names that a ``glob(...)`` fits in its place, and those that can't run here.

    Raises ``BenchError`` for a glob of what is no choice of a plugin or preset, and for one that fits nothing.
    """
    if not any("glob(" in each for each in overrides):
        return list(overrides), []
    # An experiment is looked up later; a table's is no choice that Hydra knows.
    parsed = check_overrides([each for each in overrides if not each.lstrip("+").startswith(EXPERIMENT)])
    globs = {override.input_line: override for override in parsed if isinstance(override.value(), Glob)}
    folders = config_folders(parsed)
    skipped: list[Skipped] = []
    expanded = [_without_glob(globs[each], folders, skipped) if each in globs else each for each in overrides]
    return expanded, skipped


def _without_glob(override: Override, folders: Sequence[Path], skipped: list[Skipped]) -> str:
    """The override with the names in place of its glob; adds to ``skipped`` what can't run here."""
    key, choices = override.get_key_element(), glob_choices(override, folders)
    skipped += [Skipped(Cell(f"{key}={name}", "", ()), reason) for name, reason in choices.items() if reason]
    return f"{key}={','.join(name for name, reason in choices.items() if not reason)}"


def planned_run(cell: Cell, combination: Sequence[str], swept: Sequence[str]) -> PlannedRun:
    """The run of one combination, in the folder of its hash; ``swept`` are the settings that its label tells."""
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
