"""``experiment=NAME`` of ``bgs-bench run -m``: the rows and sequences of a table of the paper, as overrides."""

from __future__ import annotations

from collections.abc import Sequence

from bench.errors import BenchError, require_choice
from bench.tables.named.definitions import TABLES, Cell, cells

EXPERIMENT = "experiment="
"""How the override begins."""


def expand_experiment(overrides: Sequence[str]) -> list[tuple[Cell, list[str]]]:
    """Each cell of the table that ``experiment=`` names, with its overrides; without it, one empty cell.

    A table's rows differ in several settings at once, so they are no product of values, which is all that Hydra's
    sweeps make. Cells that nobody can run are left out. Raises ``BenchError`` for an unknown or repeated name.
    """
    names = [each.removeprefix(EXPERIMENT) for each in overrides if each.startswith(EXPERIMENT)]
    if not names:
        return [(Cell("", "", ()), list(overrides))]
    if len(names) > 1:
        raise BenchError(f"{' '.join(EXPERIMENT + name for name in names)}: give one experiment at a time.")
    table = TABLES[require_choice("experiment", names[0], TABLES)]
    others = [each for each in overrides if not each.startswith(EXPERIMENT)]
    return [(cell, cell.overrides_with(others)) for cell in cells(table) if not cell.blocked]
