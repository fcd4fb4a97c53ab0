"""One call from run folders to a named table's text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from bench.errors import require_choice
from bench.tables.named.definitions import DIALECTS, named_table
from bench.tables.named.dialects import dialect_csv, dialect_grid, dialect_notes, scored_runs
from bench.tables.named.fill import fill
from bench.tables.named.formats import Document, as_html, as_latex, as_markdown, print_grid
from bench.tables.named.grid import Grid, PublishedNumbers, build_grid
from bench.tables.named.notes import notes
from bench.tables.named.records import VIEW_GROUPS, read_records
from bench.tables.named.tidy import as_csv

_WRITERS: dict[str, Callable[[Document], str]] = {"md": as_markdown, "tex": as_latex, "html": as_html}
FORMATS = ("md", "csv", "tex", "html")


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper, filled with runs; made by ``make_table``. ``csv`` gives its numbers, links relative to a
    folder."""

    grid: Grid
    notes: list[str]
    csv: Callable[[Path], str]

    def text(self, form: str, folder: Path) -> str:
        """The table as "md", "csv", "tex" or "html"; its links to runs are relative to ``folder``."""
        if require_choice("--format", form, FORMATS) == "csv":
            return self.csv(folder)
        return _WRITERS[form](Document(self.grid, self.notes, folder))

    def print(self, console: Console) -> None:
        """Print it with its notes."""
        print_grid(Document(self.grid, self.notes, Path()), console)


def make_table(name: str, runs: list[Path], views: str = "left") -> PaperTable:
    """The table ``name`` with the runs in ``runs`` (default ``results/runs``); the same runs give the same table.

    ``views`` says whose image and depth metrics are shown: "left", "heldout" or "right". Raises ``BenchError`` for an
    unknown name, and for a path that holds no run.
    """
    table = None if name == DIALECTS else named_table(name)
    records, problems = read_records(runs, require_choice("--views", views, VIEW_GROUPS))
    if table is None:
        scored = scored_runs(records)
        about = dialect_notes(scored, len(records) - len(scored), views, problems)
        return PaperTable(dialect_grid(name, scored), about, partial(dialect_csv, scored))
    filled = fill(table, records)
    published = PublishedNumbers(name)
    grid = build_grid(filled, published)
    about = notes(filled, published, grid, views, problems)
    return PaperTable(grid, about, partial(as_csv, filled, published))
