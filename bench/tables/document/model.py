"""A table as people read it, whatever it is of: what all writers are given."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote

if TYPE_CHECKING:
    import pandas as pd

UNKNOWN = "-"
"""The text of a cell whose value is not known."""


@dataclass(frozen=True)
class Column:
    """The heading of a column, in one line or two, and how its cells stand below it."""

    title: str
    below: str = ""
    """A unit, or how much data there is."""
    align: Literal["left", "right"] = "left"
    wraps: bool = False
    """Whether long texts may be broken in a terminal."""


@dataclass(frozen=True)
class Cell:
    """What a cell shows. ``value`` is the number behind it where there is one, a mean over ``n`` runs."""

    text: str = ""
    n: int = 0
    mark: str = ""
    best: bool = False
    value: float | None = None
    links: tuple[tuple[str, Path], ...] = ()
    """What leads to each run: how it is called here, and where it is; a document has them below its notes."""

    @property
    def plain(self) -> str:
        """The text with the number of runs and the mark."""
        return self.text + (f" ({self.n})" if self.n else "") + self.mark


@dataclass(frozen=True)
class Row:
    """``names`` stand in the columns on the left, an empty one where it is that of the row above."""

    names: tuple[str, ...]
    cells: tuple[Cell, ...]
    kind: Literal["ours", "others", "quiet"] = "ours"
    """A quiet row is no method or run, but a mark to compare with."""


@dataclass(frozen=True)
class Data:
    """The numbers behind a table with full digits, for CSV: rows by column key, None where a value is not known.

    A tuple of paths is written relative to the document's folder, with blanks between them.
    """

    columns: tuple[str, ...]
    rows: Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Document:
    """A table with its title (or none) and the notes below it; ``blocks`` of rows are kept apart by lines.

    ``left`` are the columns of names, ``columns`` those of cells. Links are relative to ``folder``.
    """

    name: str
    title: str
    left: tuple[Column, ...]
    columns: tuple[Column, ...]
    blocks: tuple[tuple[Row, ...], ...]
    notes: tuple[str, ...]
    data: Data
    folder: Path = field(default_factory=Path)
    links: tuple[tuple[str, tuple[tuple[str, Path], ...]], ...] = ()
    """Where the runs are, below the notes: what each line is of, and of each of its runs the name and the place."""

    def text(self, form: str, folder: str | Path = "") -> str:
        """It as "md", "csv", "tex" or "html", with links relative to ``folder``; ``BenchError`` for another form."""
        from bench.tables.document.forms import text_of  # whose writers need this module

        return text_of(self, form, Path(folder))

    def frame(self) -> pd.DataFrame:
        """The numbers behind it, with full digits and the columns of its CSV file; what is not known is None or NaN."""
        import pandas as pd  # takes a while to load, and few want it

        return pd.DataFrame(list(self.data.rows), columns=list(self.data.columns))

    def link(self, path: Path) -> str:
        """The address of a path as seen from the document, with forward slashes and percent-encoded, so that no name of
        a folder can be anything else (``javascript:...``). A record's line (``#L9``) stays one."""
        place, mark, line = relative(path, self.folder).rpartition("#L")
        place, line = (place, f"{mark}{line}") if mark and line.isdecimal() else (f"{place}{mark}{line}", "")
        return quote(place, safe="/~+=@,", errors="surrogateescape") + line


def relative(path: Path, folder: Path) -> str:
    """``path`` relative to ``folder``, with forward slashes."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
