"""``experiment=NAME`` of ``bgs-bench run -m``: the rows and sequences of a named table, as overrides."""

from __future__ import annotations

from collections.abc import Sequence

from bench.config import check_overrides, options_of, plugin_folders
from bench.errors import BenchError, require_choice
from bench.hydra_settings import config_folders
from bench.override_text import hydra_lines
from bench.tables.named.definitions import Cell, cells
from bench.tables.named.find import table_files
from bench.tables.named.found_rows import choose_rows
from bench.tables.named.loading import read_table

EXPERIMENT = "experiment="
"""How the override begins."""


def table_experiments(overrides: Sequence[str]) -> list[str]:
    """Those of the overrides that name a table, not a config of the user's (``+experiment=NAME``)."""
    given = [each for each in overrides if each.lstrip("+").startswith(EXPERIMENT)]
    if not given:
        return []
    own = options_of(
        "experiment", config_folders(check_overrides(hydra_lines([each for each in overrides if each not in given])))
    )
    return [each for each in given if not set(each.partition("=")[2].split(",")) & set(own)]


def expand_experiment(overrides: Sequence[str]) -> list[tuple[Cell, list[str]]]:
    """Each cell of the table that ``experiment=`` names, with its overrides; without it, one empty cell.

    A table's rows differ in several settings at once, so they are no product of values, which is all that Hydra's
    sweeps make. Cells that nobody can run are left out. Raises ``BenchError`` for an unknown or repeated name.
    """
    of_tables = table_experiments(overrides)
    names = [each.partition("=")[2] for each in of_tables]
    if not names:
        return [(Cell("", "", ()), list(overrides))]
    if len(names) > 1:
        raise BenchError(f"{' '.join(of_tables)}: give one experiment at a time.")
    others = [each for each in overrides if each not in of_tables]
    folders = plugin_folders(check_overrides(others))
    files = table_files(folders)
    table = read_table(files[require_choice("experiment", names[0], files)], folders)
    table, others = choose_rows(table, others)
    of_table = cells(table)
    found = [(cell, cell.overrides_with(others)) for cell in of_table if not cell.blocked]
    if not found:
        raise BenchError(f"No cell of {table.name} can be run: {of_table[0].blocked}")
    return found
