"""One document in every format, read back by parsers that know nothing of the writers."""

from __future__ import annotations

import csv
import html
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

ESC, BEL = chr(27), chr(7)
NASTY = {
    "a\r\nb\u2028c\x0bd\te": "a b c d e",
    f"{ESC}[31mred{ESC}[0m{ESC}]8;;http://evil{BEL}link{ESC}]8;;{BEL}": "redlink",
    "\u202egnp.exe\u202c\u200b\ufeff \x00x": "gnp.exe x",
    "half \ud800 pair": "half \ufffd pair",
    ":smile: :bomb:": ":smile: :bomb:",
    "[red]no colour[/]": "[red]no colour[/]",
    "=cmd|' /C calc'!A0": "=cmd|' /C calc'!A0",
    "+1+1": "+1+1",
    "@SUM(A1)": "@SUM(A1)",
    "-x": "-x",
    "\t=1": "=1",
    "\uff1dA1 \uff0b": "\uff1dA1 \uff0b",
    "# heading": "# heading",
    "- item": "- item",
    "1. first": "1. first",
    "> said": "> said",
    "[x] task": "[x] task",
    "[a]: http://evil": "[a]: http://evil",
    "![i](http://evil)": "![i](http://evil)",
    "<img src=x onerror=alert(1)>": "<img src=x onerror=alert(1)>",
    "\" onmouseover='alert(1)' x=\"": "\" onmouseover='alert(1)' x=\"",
    "~~gone~~ ~x~": "~~gone~~ ~x~",
    "\uff04\uff3c\uff05 full width": "\uff04\uff3c\uff05 full width",
    "*star first": "*star first",
    "^^M \\input{/etc/passwd} \\write18{x} %": "^^M \\input{/etc/passwd} \\write18{x} %",
}
"""What runs may say, and the one line of plain text that readers see of it."""


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
    assert [row[-2] for row in cells.rows[1:-1]] == [one_line(text) for text in ODD]
    # A name stands for the rows below that have none.
    assert [len(row) for row in cells.rows[1:]] == [4, 3] * (len(ODD) // 2) + [4] * (len(ODD) % 2 + 1)
    assert {"a", "i", "script"}.isdisjoint(cells.tags)


def test_csv_holds_every_sign_and_the_way_to_the_runs() -> None:
    rows = list(csv.DictReader(io.StringIO(text_of(document(ODD), "csv", Path("x")), newline="")))
    assert [row["text"] for row in rows] == [one_line(text) for text in ODD]
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
    assert '<li>Runs of x: <a href="../runs/a%7Cb">0</a> <a href="c">1</a></li>' in page
    assert "1.0 <span>(2)</span>" in page


def nasty() -> Document:
    """All of it in names, cells and notes, and beside a number."""
    return replace(document(list(NASTY)), title="")


def test_nasty_text_in_markdown() -> None:
    page = MarkdownIt("commonmark").enable(["table", "strikethrough"]).render(text_of(nasty(), "md", Path()))
    cells = Cells(page)
    assert [row[2] for row in cells.rows[1:-1]] == list(NASTY.values())
    assert set(cells.tags) <= {"p", "strong", "table", "thead", "tbody", "tr", "th", "td", "em", "ul", "li"}
    assert [html.unescape(note) for note in re.findall("<li>(.*)</li>", page)] == list(NASTY.values())


def test_nasty_text_in_html() -> None:
    cells = Cells(text_of(nasty(), "html", Path()))
    assert [row[-2] for row in cells.rows[1:-1]] == list(NASTY.values())
    assert {"a", "img", "script"}.isdisjoint(cells.tags)


def test_nasty_text_in_csv() -> None:
    rows = list(csv.DictReader(io.StringIO(text_of(nasty(), "csv", Path("x")), newline="")))
    assert [row["text"].removeprefix("'") for row in rows] == list(NASTY.values())
    assert not [row["text"] for row in rows if row["text"].startswith(("=", "+", "-", "@", "\t", "\r", "\uff1d"))]
    numbers = Data(("a", "b", "c"), [{"a": -1.5, "b": "-2.5e-3", "c": -7}])
    assert text_of(replace(nasty(), data=numbers), "csv", Path()) == "a,b,c\n-1.5,-2.5e-3,-7\n"


def test_nasty_text_in_latex() -> None:
    text = text_of(replace(nasty(), title="t", name="a}b\n"), "tex", Path())
    assert text.isascii()
    assert not re.search(r"[^\n -~]", text)
    assert r"\label{tab:a-b-}" in text
    body = text.partition(r"\toprule")[2].partition(r"\bottomrule")[0].strip().splitlines()
    assert len(body) == 1 + 1 + 1 + len(NASTY) + 1 + 1 + 1 - 1
    for line in (line for line in body if line != r"\midrule"):
        bare = re.sub(
            r"\\(?:[&%$#_{}]|textbackslash\{\}|textasciitilde\{\}|textasciicircum\{\}|scriptsize|textbf)", "", line
        )
        assert bare.endswith(r"\\")
        # After the end of a row these would be its options.
        assert not bare.startswith(("[", "*"))
        assert not re.search(r"[%#~^_]", re.sub(r"\$[<>|]\$", "", bare))
        assert "\\" not in bare[:-2].replace(r"\textit", "")


def test_nasty_text_on_the_terminal() -> None:
    console = Console(file=io.StringIO(), width=400, force_terminal=True, color_system=None)
    print_document(nasty(), console)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    for text in NASTY.values():
        assert shown.count(text) >= 2, text  # long names are broken
    shown = re.sub(r"\x1b\[(?:0|1|2;3)m", "", shown)  # our own bold heads and dim rows
    assert not [sign for sign in shown if not sign.isprintable() and sign != "\n"]


def test_no_name_of_a_folder_makes_a_link_anything_else() -> None:
    names = ["javascript:alert(1)", "a\"b<c>'d", "e#f?g%h", "i\nj", "data:x,y"]
    links = tuple(("0", Path(name)) for name in names)
    one = replace(document([]), links=(("x", links),))
    assert [one.link(Path(name)) for name in names] == [
        *("javascript%3Aalert%281%29", "a%22b%3Cc%3E%27d", "e%23f%3Fg%25h", "i%0Aj", "data%3Ax,y"),
    ]
    assert one.link(Path("t/x.runs.json#L9")) == "t/x.runs.json#L9"
    for form in ("md", "html"):
        page = text_of(one, form, Path())
        page = MarkdownIt("commonmark").enable("table").render(page) if form == "md" else page
        assert len(re.findall('<a href="[^"<> ]+">0</a>', page)) == len(names)


def test_other_forms_are_refused() -> None:
    with pytest.raises(BenchError, match=r"--format='pdf' is not one of md, csv, tex, html"):
        text_of(document([]), "pdf", Path())
    with pytest.raises(BenchError, match=r"--out t\.txt: the extension says the form"):
        form_of(Path("t.txt"))
