"""One call from run folders to a named table's text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from rich.console import Console

from bench.errors import BenchError, require_choice
from bench.io.atomic import write_text
from bench.tables.named.definitions import NamedTable
from bench.tables.named.dialects import dialect_csv, dialect_grid, dialect_notes, scored_groups
from bench.tables.named.fill import fill, is_of
from bench.tables.named.find import DIALECTS, named_table
from bench.tables.named.foreign import with_foreign_rows
from bench.tables.named.formats import as_markdown, print_grid
from bench.tables.named.grid import Grid, PublishedNumbers, build_grid
from bench.tables.named.latex import as_latex
from bench.tables.named.layout import Document
from bench.tables.named.notes import notes
from bench.tables.named.overrides import row_of
from bench.tables.named.page import as_html
from bench.tables.named.records import read_runs
from bench.tables.named.tidy import as_csv
from bench.tables.records.file import SUFFIX, KeptRuns, lead_to, record_text
from bench.tables.records.record import VIEW_GROUPS

_WRITERS: dict[str, Callable[[Document], str]] = {"md": as_markdown, "tex": as_latex, "html": as_html}
FORMATS = ("md", "csv", "tex", "html")


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper, filled with ``runs``; made by ``make_table``. ``csv`` gives its numbers, links relative to
    a folder."""

    grid: Grid
    notes: list[str]
    csv: Callable[[Path], str]
    runs: KeptRuns
    table: NamedTable | None
    """None: the table of dialects."""

    def text(self, form: str, folder: Path) -> str:
        """The table as "md", "csv", "tex" or "html"; its links to runs are relative to ``folder``."""
        if require_choice("--format", form, FORMATS) == "csv":
            return self.csv(folder)
        return _WRITERS[form](Document(self.grid, self.notes, folder))

    def print(self, console: Console) -> None:
        """Print it with its notes."""
        print_grid(Document(self.grid, self.notes, Path()), console)

    def write(self, folder: Path, forms: Sequence[str] = FORMATS) -> list[Path]:
        """Write NAME.md, .csv, .tex, .html and NAME.runs.json, from which ``make_table`` makes the same table again.

        The links lead to the lines of that record, so that they hold without the run folders. Returns the files; raises
        ``BenchError`` for a folder that can't be made.
        """
        name = self.grid.name
        record = folder / f"{name}{SUFFIX}"
        texts = {record: record_text(self.runs)}
        linked = _table_of(self.table, lead_to(self.runs, record))
        texts |= {folder / f"{name}.{form}": linked.text(form, folder) for form in forms}
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BenchError(
                f"Can't make the folder of --out {folder}: {error.strerror}. Give another place."
            ) from error
        for file, text in texts.items():
            write_text(file, text)
        return list(texts)


def make_table(name: str, runs: Sequence[Path], views: str | None = None, folders: Sequence[str] = ()) -> PaperTable:
    """The table ``name`` with the runs in ``runs`` (default ``results/runs``), run folders or record files.

    The same runs give the same table. ``views`` says whose image and depth metrics are shown: "left", "heldout" or
    "right"; None: those of a record file, else "left". ``folders`` are the user's, with tables of theirs. Raises
    ``BenchError`` for an unknown name, and for a path that holds no run.
    """
    table = None if name == DIALECTS else named_table(name, folders)
    if views is not None:
        require_choice("--views", views, VIEW_GROUPS)
    return _table_of(table, _of_table(table, read_runs(runs, views)))


def _of_table(table: NamedTable | None, found: KeptRuns) -> KeptRuns:
    """The runs that have a place in the table; of the others, how many there are."""
    if table is None:
        members = [run for run in found.runs if run.part("dialects")]
        strangers = len(found.runs) - len(members)
    else:
        table = with_foreign_rows(table, [run.config for run in found.runs])
        members = [run for run in found.runs if row_of(table, run.config) is not None]
        strangers = sum(is_of(run, table) for run in found.runs) - len(members)
    # Another table's record counted those that had no place there.
    name = DIALECTS if table is None else table.name
    known = found.others if found.table == name else 0
    return replace(found, table=name, runs=tuple(members), others=known + strangers)


def _table_of(table: NamedTable | None, found: KeptRuns) -> PaperTable:
    if table is None:
        groups = scored_groups(found.runs)
        about = dialect_notes(groups, found.others, found.views, found.problems)
        return PaperTable(dialect_grid(DIALECTS, groups), about, partial(dialect_csv, groups), found, None)
    # Views that the paper's protocol does not have are chosen together with another protocol.
    filled = fill(table, found.runs, found.others, table.protocol if found.views == "left" else "")
    published = PublishedNumbers(table)
    grid = build_grid(filled, published)
    about = notes(filled, published, grid, found.views, found.problems)
    return PaperTable(grid, about, partial(as_csv, filled, published), found, table)
