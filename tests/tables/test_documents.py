"""One document in every format, read back by parsers that know nothing of the writers."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from rich.console import Console

from bench.errors import BenchError
from bench.tables.document.forms import form_of, text_of
from bench.tables.document.model import Cell, Column, Data, Document, Row
from bench.tables.document.terminal import print_document

ODD = [
    "a|b",
    "<b>c</b>",
    "d & e &amp;",
    "f_g_h",
    "*i* `j`",
    "\\k \\| l\\",
    "[m](http://n)",
    "50 % #1 ~ ^ $x$ {y}",
    "two\nlines",
]


def document(texts: list[str]) -> Document:
    cells = [(Cell(text), Cell("1.0", best=True)) for text in texts]
    rows = tuple(Row((text if n % 2 == 0 else "", "by"), cells[n]) for n, text in enumerate(texts))
    quiet = Row(("static", "computed"), (Cell("-"), Cell("2.0")), "quiet")
    runs = (Path("x/a"), Path("b"))
    return Document(
        name="odd",
        title=" ".join(texts),
        left=(Column("Method", wraps=True), Column("By")),
        columns=(Column("Text_1"), Column("Number", "[m|n]", "right")),
        blocks=(rows, (quiet,)),
        notes=tuple(texts),
        data=Data(("text", "value", "runs"), [{"text": text, "value": 0.1, "runs": runs} for text in texts]),
    )


class Cells(HTMLParser):
    """The rows of a page's tables as texts, each cell in every row that it reaches into; and its tags."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: list[str] = []
        self._inside = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self._inside = True

    def handle_endtag(self, tag: str) -> None:
        self._inside = self._inside and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.rows[-1][-1] += data


def one_line(text: str) -> str:
    return text.replace("\n", " ")


def test_markdown_shows_every_sign_as_it_is() -> None:
    """By another library's reading of GitHub's tables."""
    page = MarkdownIt("commonmark").enable("table").render(text_of(document(ODD), "md", Path()))
    cells = Cells(page)
    assert cells.rows[0] == ["Method", "By", "Text_1", "Number [m|n]"]
    assert [row[2] for row in cells.rows[1:-1]] == [one_line(text) for text in ODD]
    assert cells.rows[-1] == ["static", "computed", "-", "2.0"]
    assert set(cells.tags) <= {"p", "strong", "table", "thead", "tbody", "tr", "th", "td", "em", "ul", "li"}
    assert page.count("<li>") == len(ODD)


def test_html_shows_every_sign_as_it_is() -> None:
    cells = Cells(text_of(document(ODD), "html", Path()))
    assert [row[-2] for row in cells.rows[1:-1]] == ODD
    # A name stands for the rows below that have none.
    assert [len(row) for row in cells.rows[1:]] == [4, 3] * (len(ODD) // 2) + [4] * (len(ODD) % 2 + 1)
    assert {"a", "i", "script"}.isdisjoint(cells.tags)


def test_csv_holds_every_sign_and_the_way_to_the_runs() -> None:
    rows = list(csv.DictReader(io.StringIO(text_of(document(ODD), "csv", Path("x")), newline="")))
    assert [row["text"] for row in rows] == ODD
    assert {(row["value"], row["runs"]) for row in rows} == {("0.1", "a ../b")}


def test_latex_rows_stay_whole() -> None:
    text = text_of(document(ODD), "tex", Path())
    body = text.partition(r"\toprule")[2].partition(r"\bottomrule")[0].strip().splitlines()
    assert all(line.endswith(r"\\") or line == r"\midrule" for line in body)
    bare = [re.sub(r"\\[&%$#_{}]", "", line) for line in body if line != r"\midrule"]
    assert {line.count("&") for line in bare} == {3}
    assert not any(re.search(r"[%#~|<>]", re.sub(r"\$[<>|]\$", "", line)) for line in bare)


def test_without_a_title_latex_is_a_tabular_for_ones_own_float() -> None:
    text = text_of(replace(document(["two\nlines"]), title=""), "tex", Path())
    assert text.splitlines()[0] == "% two lines"
    assert text.splitlines()[1].startswith(r"\begin{tabular}{lllr}")
    assert "table*" not in text


def test_the_terminal_takes_no_text_for_markup() -> None:
    console = Console(file=io.StringIO(), width=200)
    print_document(replace(document(["[bold]x[/bold]"]), title="[red]t"), console)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "[red]t" in shown
    assert shown.count("[bold]x[/bold]") == 3


def test_links_to_runs_stand_below_the_notes_as_seen_from_the_documents_folder() -> None:
    links = (("x", (("0", Path("runs/a|b")), ("1", Path("tables/c")))),)
    one = replace(document([]), blocks=((Row(("x", "ours"), (Cell(), Cell("1.0", 2))),),), links=links)
    page = MarkdownIt("commonmark").enable("table").render(text_of(one, "md", Path("tables")))
    assert '<li>Runs of x: <a href="../runs/a%7Cb">0</a> <a href="c">1</a></li>' in page
    assert ">1.0 (2)</td>" in page
    page = text_of(one, "html", Path("tables"))
    assert '<li>Runs of x: <a href="../runs/a|b">0</a> <a href="c">1</a></li>' in page
    assert "1.0 <span>(2)</span>" in page


def test_other_forms_are_refused() -> None:
    with pytest.raises(BenchError, match=r"--format='pdf' is not one of md, csv, tex, html"):
        text_of(document([]), "pdf", Path())
    with pytest.raises(BenchError, match=r"--out t\.txt: the extension says the form"):
        form_of(Path("t.txt"))
