"""A named table in LaTeX, with booktabs rules."""

from __future__ import annotations

from bench.tables.latex import latex_text
from bench.tables.named.grid import Grid, GridCell
from bench.tables.named.layout import Document, is_quiet, left_headings, left_names, plain


def as_latex(document: Document) -> str:
    r"""A ``table*``, as wide as the text at most, its first note in the caption and the others below; ASCII.

    Needs ``\usepackage{booktabs}`` and ``\usepackage{graphicx}``.
    """
    grid = document.grid
    first, *others = document.notes or [""]
    lines = [
        r"% needs \usepackage{booktabs,graphicx}",
        r"\begin{table*}[p]",
        r"\centering",
        rf"\caption{{\textbf{{{latex_text(grid.title)}.}} {latex_text(first)}}}",
        rf"\label{{tab:{grid.name}}}",
        r"\par\medskip",
        # Shrunk only where it would stand out of the text.
        r"\sbox0{\small\setlength{\tabcolsep}{4pt}%",
        *_tabular(grid),
        r"}%",
        r"\ifdim\wd0>\textwidth\resizebox{\textwidth}{!}{\usebox0}\else\usebox0\fi",
    ]
    if others:
        # One paragraph: the notes of a main table would not fit its page as lines of their own.
        lines += [r"\par\smallskip", r"\begin{minipage}{\textwidth}\scriptsize"]
        lines += [latex_text(note) for note in others]
        lines += [r"\end{minipage}"]
    return "\n".join([*lines, r"\end{table*}"]) + "\n"


def _tabular(grid: Grid) -> list[str]:
    left = left_headings(grid)
    lines = [rf"\begin{{tabular}}{{{'l' * len(left)}{'r' * len(grid.columns)}}}", r"\toprule"]
    heads = [_head(name) for name in grid.columns]
    lines.append(_row([*left, *(upper for upper, _ in heads)]))
    if any(lower for _, lower in heads):
        lower_row = [*("" for _ in left), *(rf"\scriptsize {lower}" if lower else "" for _, lower in heads)]
        lines.append(_row(lower_row))
    for block in grid.blocks:
        lines.append(r"\midrule")
        for line, names in zip(block, left_names(grid, block), strict=True):
            cells = [_cell(cell, is_quiet(line)) for cell in line.cells]
            lines.append(_row([*(latex_text(name) for name in names), *cells]))
    return [*lines, r"\bottomrule", r"\end{tabular}%"]


def _head(name: str) -> tuple[str, str]:
    """A column's heading over two lines: ``03 (0.56/801)`` has km and frames below."""
    upper, bracket, lower = name.partition(" (")
    return latex_text(upper), latex_text(f"({lower}") if bracket else ""


def _row(cells: list[str]) -> str:
    return " & ".join(cells) + r" \\"


def _cell(cell: GridCell, quiet: bool) -> str:
    text = latex_text(plain(cell))
    if not text:
        return ""
    return rf"\textbf{{{text}}}" if cell.best else rf"\textit{{{text}}}" if quiet else text
