"""What overrides with several values stand for: ``a,b``, ``choice``, ``range`` and ``glob``, and every combination."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

from hydra.core.override_parser.types import Glob, Override, RangeSweep
from hydra.errors import HydraException

from bench import registry
from bench.config import RunConfig, check_overrides, compose_run, options_of
from bench.errors import BenchError, first_line
from bench.hydra_settings import config_folders
from bench.override_text import hydra_lines


def combinations(overrides: Sequence[str]) -> list[list[str]]:
    """The overrides of every combination of the values that ``-m`` would run; raises ``BenchError`` for wrong ones."""
    choices: list[list[str]] = []
    parsed = check_overrides(hydra_lines(overrides))
    folders = config_folders(parsed)
    for override in parsed:
        line = override.input_line or ""
        if not override.is_sweep_override():
            choices.append([line])
            continue
        if override.is_interval_sweep():
            raise BenchError(
                f"{line}: an interval is searched, not enumerated. "
                "Add sweeper=optuna sweeper.metric=NAME, or write a,b,c or range(FROM,TO,STEP)."
            )
        try:
            choices.append([f"{override.get_key_element()}={value}" for value in _values(override, folders)])
        except HydraException as error:
            raise BenchError(f"{line}: {first_line(error)}. Write the values with commas between them.") from error
    return [list(cell) for cell in itertools.product(*choices)]


def glob_choices(override: Override, folders: Sequence[Path]) -> dict[str, str]:
    """The names that ``stereo=glob(...)`` fits, each with why it can't run here, or an empty string.

    Raises ``BenchError`` for a glob of what is no choice of a plugin or preset, and where nothing that fits can run.
    """
    glob, group = override.value(), override.key_or_group.replace(".", "/")
    assert isinstance(glob, Glob)
    options = options_of(group, folders)
    if not options:
        raise BenchError(
            f"{override.input_line}: glob(...) chooses plugins and presets, as stereo=glob(*). Write a,b,c here."
        )
    kind = registry.nested_groups.get(group, group)
    found = {}
    for name in glob.filter(options):
        plugin = registry.lookup(kind, name) if name in registry.names(kind) else None  # else a preset
        found[name] = "" if plugin is None else plugin.unavailable_reason() or plugin.missing_weights() or ""
    if all(found.values()):
        raise BenchError(f"{override.input_line} fits nothing that can run here; there are {', '.join(options)}.")
    return found


def _values(override: Override, folders: Sequence[Path]) -> list[str]:
    """What a swept override enumerates; raises ``HydraException`` for an impossible range."""
    sweep = override.value()
    if isinstance(sweep, Glob):
        return [name for name, reason in glob_choices(override, folders).items() if not reason]
    if isinstance(sweep, RangeSweep) and not sweep.shuffle:
        # As one writes them: not 0.30000000000000004.
        return [str(round(value, 12)) for value in sweep.range()]
    return list(override.sweep_string_iterator())


def compose_sweep(overrides: Sequence[str]) -> list[RunConfig]:
    """Compose every combination that ``-m`` would run, so that a wrong value is known before the first run starts."""
    return [compose_run(cell) for cell in combinations(overrides)]
