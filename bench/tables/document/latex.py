"""A document in LaTeX, with booktabs rules."""

from __future__ import annotations

import re

from bench.tables.document.latex_text import latex_text
from bench.tables.document.model import Cell, Column, Document


def as_latex(document: Document) -> str:
    r"""ASCII that needs ``\usepackage{booktabs}``, and ``\usepackage{graphicx}`` for a document with a title.

    A document with a title is a ``table*`` that fits its page, in width and in height: its first note is in the
    caption, the others are below or, where the page has no room for them, in the text that follows. One without is a
    ``tabular`` for a float of the author's, its notes in comments above.
    """
    if not document.title:
        comments = [f"% {latex_text(note)}" for note in document.notes]
        return "\n".join([*comments, *_tabular(document)]) + "\n"
    first, *others = document.notes or ("",)
    title = latex_text(document.title)
    lines = [
        r"% needs \usepackage{booktabs,graphicx}",
        rf"\long\def\BenchCaption{{\textbf{{{title}.}} {latex_text(first)}}}%",
        # One paragraph: the notes of a main table would not fit its page as lines of their own.
        r"\long\def\BenchNotes{%",
        *(latex_text(note) for note in others),
        r"}%",
        r"\gdef\BenchNotesBelow{}%",
        r"\begin{table*}[p]",
        r"\centering",
        r"\caption{\BenchCaption}",
        rf"\label{{tab:{re.sub(r'[^A-Za-z0-9_.-]', '-', document.name)}}}",
        r"\par\medskip",
        r"\sbox0{\small\setlength{\tabcolsep}{4pt}%",
        *_tabular(document, "%"),
        r"}%",
        # Four lines for its number and the spaces above and below it.
        r"\sbox6{\parbox{\textwidth}{\BenchCaption}}%",
        r"\edef\BenchRoom{\the\dimexpr\textheight-\ht6-\dp6-4\baselineskip\relax}%",
        # Shrunk only where it would stand out of the text: to its width, ...
        r"\sbox2{\ifdim\wd0>\textwidth\resizebox{\textwidth}{!}{\usebox0}\else\usebox0\fi}%",
        r"\sbox4{\begin{minipage}{\textwidth}\scriptsize\BenchNotes\end{minipage}}%",
        # ... and to the height that caption and notes leave. Long notes follow in the text rather than shrink it.
        r"\ifdim\dimexpr\ht2+\dp2+\ht4+\dp4\relax>\BenchRoom\ifdim\dimexpr(\ht4+\dp4)*4\relax>\BenchRoom",
        rf"\gdef\BenchNotesBelow{{\par\noindent{{\scriptsize\textbf{{{title}:}} \BenchNotes\par}}}}\sbox4{{}}\fi\fi",
        r"\edef\BenchRoom{\the\dimexpr\BenchRoom-\ht4-\dp4\relax}%",
        r"\ifdim\dimexpr\ht2+\dp2\relax>\BenchRoom",
        r"\resizebox*{!}{\BenchRoom}{\usebox2}\else\usebox2\fi",
        r"\par\smallskip\usebox4",
        r"\end{table*}",
        r"\BenchNotesBelow",
    ]
    return "\n".join(lines) + "\n"


def _tabular(document: Document, end: str = "") -> list[str]:
    columns = [*document.left, *document.columns]
    alignment = "".join("r" if column.align == "right" else "l" for column in columns)
    lines = [rf"\begin{{tabular}}{{{alignment}}}", r"\toprule", _row([latex_text(column.title) for column in columns])]
    if any(column.below for column in columns):
        lines.append(_row([_below(column) for column in columns]))
    for block in document.blocks:
        lines.append(r"\midrule")
        for row in block:
            cells = [_cell(cell, row.kind == "quiet") for cell in row.cells]
            lines.append(_row([*(latex_text(name) for name in row.names), *cells]))
    return [*lines, r"\bottomrule", rf"\end{{tabular}}{end}"]


def _below(column: Column) -> str:
    return rf"\scriptsize {latex_text(column.below)}" if column.below else ""


def _row(cells: list[str]) -> str:
    # After the end of a row, LaTeX takes a bracket or a star for an option of it.
    guard = "{}" if cells and cells[0].startswith(("[", "*")) else ""
    return guard + " & ".join(cells) + r" \\"


def _cell(cell: Cell, quiet: bool) -> str:
    text = latex_text(cell.plain)
    if not text:
        return ""
    return rf"\textbf{{{text}}}" if cell.best else rf"\textit{{{text}}}" if quiet else text
