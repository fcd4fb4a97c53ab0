"""One call from run folders to a named table's text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from bench.errors import BenchError, require_choice
from bench.tables.document.forms import FORMS, save
from bench.tables.document.model import Document
from bench.tables.document.terminal import print_document
from bench.tables.named.definitions import NamedTable
from bench.tables.named.dialects import dialect_data, dialect_grid, dialect_notes, scored_groups
from bench.tables.named.fill import fill, is_of
from bench.tables.named.find import DIALECTS, named_table
from bench.tables.named.found_rows import why_in_no_row, with_found_rows
from bench.tables.named.grid import PublishedNumbers, build_grid
from bench.tables.named.layout import document_of
from bench.tables.named.notes import notes
from bench.tables.named.overrides import row_of
from bench.tables.named.records import read_runs
from bench.tables.named.tidy import tidy_data
from bench.tables.records.file import SUFFIX, TableRecord, lead_to, record_text
from bench.tables.records.record import VIEW_GROUPS
from bench.tables.records.settings import first_few


@dataclass(frozen=True)
class PaperTable:
    """A named table filled with ``runs``; made by ``make_table``."""

    document: Document
    runs: TableRecord
    table: NamedTable | None
    """None: the table of dialects."""
    columns_of: str = "both"
    left_out: tuple[str, ...] = ()
    """Why runs on its data set have no cell, where one setting says it; for who prints it, as no record keeps it."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What stands below it."""
        return self.document.notes

    def text(self, form: str, folder: Path) -> str:
        """The table as "md", "csv", "tex" or "html"; its links to runs are relative to ``folder``."""
        return self.document.text(form, folder)

    def print(self, console: Console) -> None:
        """Print it with its notes."""
        print_document(self.document, console)
        for reason in self.left_out:
            console.print(reason, markup=False, highlight=False, soft_wrap=True)

    def write(self, folder: Path, forms: Sequence[str] = FORMS) -> list[Path]:
        """Write NAME.md, .csv, .tex, .html and NAME.runs.json, from which ``make_table`` makes the same table again.

        The links lead to the lines of that record, so that they hold without the run folders. Returns the files; raises
        ``BenchError`` for a folder that can't be made.
        """
        name = self.document.name
        record = folder / f"{name}{SUFFIX}"
        texts = {record: record_text(self.runs)}
        linked = _table_of(self.table, lead_to(self.runs, record), self.columns_of)
        texts |= {folder / f"{name}.{form}": linked.text(form, folder) for form in forms}
        for file, text in texts.items():
            save(file, text)
        return list(texts)


def make_table(
    name: str,
    runs: Sequence[Path],
    views: str | None = None,
    folders: Sequence[str] = (),
    columns_of: str = "both",
) -> PaperTable:
    """The table ``name`` with the runs in ``runs`` (default ``results/runs``), run folders or record files.

    The same runs give the same table. ``views`` says whose image and depth metrics are shown: "left", "heldout" or
    "right"; None: those of a record file, else "left". ``folders`` are the user's, with tables of theirs.
    ``columns_of`` says whose numbers: "ours", the "paper"'s or "both". Raises ``BenchError`` for an
    unknown name, and for a path that holds no run.
    """
    table = None if name == DIALECTS else named_table(name, folders)
    if views is not None:
        require_choice("--views", views, VIEW_GROUPS)
    if table is None and columns_of != "both":
        raise BenchError(f"--columns {columns_of}: the table {DIALECTS} has no published numbers. Leave it out.")
    return fill_table(table, read_runs(runs, views), columns_of)


def fill_table(table: NamedTable | None, found: TableRecord, columns_of: str = "both") -> PaperTable:
    """The table (None: that of dialects) with those of the runs that have a place in it."""
    filled = _table_of(table, _of_table(table, found), columns_of)
    return filled if table is None else replace(filled, left_out=_left_out(table, filled.runs, found))


def _left_out(table: NamedTable, shown: TableRecord, found: TableRecord) -> tuple[str, ...]:
    """A line for each setting that keeps runs out."""
    names = {run.name for run in shown.runs}
    by_reason: dict[str, list[str]] = {}
    for run in found.runs:
        reason = why_in_no_row(table, run.config) if is_of(run, table) and run.name not in names else ""
        if reason:
            by_reason.setdefault(reason, []).append(run.name)
    return tuple(f"In no cell: {first_few(runs)}: {reason}." for reason, runs in by_reason.items())


def _of_table(table: NamedTable | None, found: TableRecord) -> TableRecord:
    """The runs that have a place in the table; of the others, how many there are."""
    if table is None:
        members = [run for run in found.runs if run.part("dialects")]
        strangers = len(found.runs) - len(members)
    else:
        table = with_found_rows(table, [run.config for run in found.runs])
        members = [run for run in found.runs if row_of(table, run.config) is not None]
        strangers = sum(is_of(run, table) for run in found.runs) - len(members)
    # Another table's record counted those that had no place there.
    name = DIALECTS if table is None else table.name
    known = found.others if found.table == name else 0
    return replace(found, table=name, runs=tuple(members), others=known + strangers)


def _table_of(table: NamedTable | None, found: TableRecord, columns_of: str) -> PaperTable:
    if table is None:
        groups = scored_groups(found.runs)
        about = dialect_notes(groups, found.others, found.views, found.problems)
        document = document_of(dialect_grid(DIALECTS, groups), about, dialect_data(groups))
        return PaperTable(document, found, None)
    # Views that the paper's protocol does not have are chosen together with another protocol.
    filled = fill(table, found.runs, found.others, table.protocol if found.views == "left" else "")
    published = PublishedNumbers(table)
    grid = build_grid(filled, published, columns_of)
    about = notes(filled, published, grid, found.views, found.problems, columns_of)
    data = tidy_data(filled, published, columns_of)
    return PaperTable(document_of(grid, about, data), found, table, columns_of)
