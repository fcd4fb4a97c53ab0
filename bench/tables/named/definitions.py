"""What a named table is: which rows, columns and metrics it has, and which overrides make a run belong to a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bench.contracts.metric import Metric
from bench.errors import BenchError
from bench.tables.named.published import SequenceFacts


@dataclass(frozen=True)
class MethodRow:
    """A method. Our runs belong to it whose config agrees with all ``overrides`` and with none of ``never``."""

    label: str
    overrides: tuple[str, ...] | None = None
    """As for ``bgs-bench run``; None: no system of ours does this yet."""
    never: tuple[str, ...] = ()
    published: str = ""
    """The method's name in the published numbers."""
    compared_with: str = ""
    """The published name of another method, to which our numbers are compared."""
    on_part: bool = False
    """Its runs are over the ``part`` of each sequence, where the user does not choose frames."""
    iterations: tuple[str, ...] = ()
    """The settings that count iterations, as the method has them; where a run had fewer, the table says so."""
    note: str = ""
    """What a reader must know of its runs: in what they differ from the method as it was published."""


@dataclass(frozen=True)
class NamedTable:
    """A table of a paper, as its file in ``conf/table`` or in a user's folder says; see ``loading``."""

    name: str
    file: Path
    title: str
    dataset: str
    sequences: Mapping[str, tuple[str, ...]]
    """The columns' names, each with the overrides that choose it: ``dataset.sequence=03``."""
    metrics: tuple[Metric, ...]
    rows: tuple[MethodRow, ...]
    across: Literal["sequences", "metrics"]
    """What its columns are."""
    about: str = ""
    """What its caption says of the paper's numbers."""
    protocol: str = "paper"
    """How its runs are scored unless the user wants another."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Those of a cell's runs."""
    published: tuple[Path, ...] = ()
    """CSV files with the paper's numbers."""
    references: tuple[Path, ...] = ()
    """CSV files with numbers from elsewhere: a static camera, other systems' own papers."""
    other_rows: str = ""
    """A kind of plugin ("stereo"): each one that runs have and no row names gets a row of its own; empty: none does."""
    overrides: tuple[str, ...] = ()
    """Those that all rows of ours share ..."""
    never: tuple[str, ...] = ()
    """... and what none of their runs has."""
    part: tuple[str, ...] = ()
    """Overrides that choose a part of each sequence, for the rows that are ``on_part``."""
    facts: Mapping[str, SequenceFacts] | None = None
    """What is known of its sequences; None: nothing."""

    def facts_of(self, sequence: str) -> SequenceFacts:
        """Length and frames of a sequence, zeros where they are not known."""
        return (self.facts or {}).get(sequence) or SequenceFacts(self.dataset, sequence)


@dataclass(frozen=True)
class Cell:
    """What has to be run for a place in the table: ``row`` is a method's label, ``column`` a sequence.

    ``overrides`` are those of ``bgs-bench run``, without the seed and without where the data set lies. ``blocked``
    says why nobody can run it, or is empty. ``defaults`` hold where the user does not say otherwise, and so does
    ``part``, which chooses a part of a sequence that has more. ``source`` says where the row is defined.
    """

    row: str
    column: str
    overrides: tuple[str, ...]
    blocked: str = ""
    defaults: tuple[str, ...] = ()
    source: str = ""
    part: tuple[str, ...] = ()

    def overrides_with(self, common: Sequence[str]) -> list[str]:
        """What a run of this cell is composed of, with a user's overrides ``common`` that are for all cells."""
        chosen = {each.partition("=")[0] for each in common}
        own = (each for each in (*self.defaults, *self.part) if each.partition("=")[0] not in chosen)
        return [*own, *common, *self.overrides]


def cells(table: NamedTable) -> list[Cell]:
    """Every place of the table that runs of ours can fill, row by row; each wants one run for each of its seeds.

    Raises ``BenchError`` for a table without any.
    """
    found = [
        Cell(
            row.label,
            sequence,
            (f"dataset={table.dataset}", *chosen, *row.overrides),
            table.facts_of(sequence).withheld,
            (f"protocol={table.protocol}",),
            f"{table.file}, row '{row.label}'",
            table.part if row.on_part else (),
        )
        for row in table.rows
        if row.overrides is not None
        for sequence, chosen in table.sequences.items()
    ]
    if not found:
        raise BenchError(f"{table.file} has no row of ours, so there is nothing to run. Give a row overrides.")
    return found
