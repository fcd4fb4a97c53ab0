"""A named table for the terminal, and as Markdown, LaTeX (booktabs) and HTML."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.tables.named.grid import COMPUTED, CROSS, DAGGER, ELSEWHERE, MINUS, Grid, GridCell, Line, heading
from bench.tables.named.links import relative
from bench.tables.render import LATEX_SPECIAL

_LATEX = LATEX_SPECIAL | {
    "±": r"$\pm$",
    MINUS: r"$-$",
    CROSS: r"$\times$",
    DAGGER: r"$^\dagger$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
}
_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;margin:2rem;color-scheme:light dark}"
    "table{border-collapse:collapse;border-top:2px solid;border-bottom:2px solid}"
    "caption{text-align:left;font-weight:600;padding-bottom:.6rem}"
    "th,td{padding:.15rem .7rem;white-space:nowrap;font-variant-numeric:tabular-nums}"
    "td.n,th.n{text-align:right}th{text-align:left;font-weight:600}thead{border-bottom:1px solid}"
    "tbody{border-top:1px solid #8886}tr.quiet td{opacity:.75;font-style:italic}"
    "div{overflow-x:auto}ul{max-width:70rem;font-size:.9em}"
)


@dataclass(frozen=True)
class Document:
    """A grid, the notes below it, and the folder that its links are relative to."""

    grid: Grid
    notes: Sequence[str]
    folder: Path

    def link(self, run: Path) -> str:
        """Where a run folder lies, seen from the document."""
        return relative(run, self.folder)


def print_grid(document: Document, console: Console) -> None:
    """Print table and notes; a line longer than the terminal is folded by the terminal, so that it can be piped."""
    grid = document.grid
    table = Table(title=grid.title, title_justify="left")
    for name in _headings(grid):
        table.add_column(name)
    for name in grid.columns:
        table.add_column(Text(name.replace(" (", "\n(")), justify="right", no_wrap=True)
    for block in grid.blocks:
        for line, names in zip(block, _names(grid, block), strict=True):
            cells = [Text(_plain(cell), style="bold" if cell.best else "") for cell in line.cells]
            table.add_row(*(Text(name) for name in names), *cells, style="dim italic" if _is_quiet(line) else "")
        table.add_section()
    Console(file=console.file, width=10_000).print(table)
    for note in document.notes:
        console.print(note, markup=False, highlight=False, soft_wrap=True)


def as_markdown(document: Document) -> str:
    """Title, table and notes; each of our numbers links to its runs, named by their seeds."""
    grid = document.grid
    left = len(_headings(grid))
    lines = [f"**{grid.title}**", "", _markdown_row([*_headings(grid), *grid.columns])]
    lines.append("|" + "---|" * left + "---:|" * len(grid.columns))
    for block in grid.blocks:
        for line, names in zip(block, _names(grid, block), strict=True):
            cells = [_markdown_cell(document, cell, _is_quiet(line)) for cell in line.cells]
            lines.append(_markdown_row([*(_escaped(name) for name in names), *cells]))
    return "\n".join([*lines, "", *(f"- {_escaped(note)}" for note in document.notes)]) + "\n"


def as_latex(document: Document) -> str:
    """A ``table*`` with booktabs rules and the notes in its caption; needs ``\\usepackage{booktabs}``, and is ASCII."""
    grid = document.grid
    left = len(_headings(grid))
    lines = [r"\begin{table*}", r"\centering\small", r"\setlength{\tabcolsep}{3pt}"]
    lines += [rf"\begin{{tabular}}{{{'l' * left}{'r' * len(grid.columns)}}}", r"\toprule"]
    lines.append(" & ".join(_latex(name) for name in [*_headings(grid), *grid.columns]) + r" \\")
    for block in grid.blocks:
        lines.append(r"\midrule")
        for line, names in zip(block, _names(grid, block), strict=True):
            cells = [_latex_cell(cell, _is_quiet(line)) for cell in line.cells]
            lines.append(" & ".join([*(_latex(name) for name in names), *cells]) + r" \\")
    caption = " ".join([rf"\textbf{{{_latex(grid.title)}.}}", *(_latex(note) for note in document.notes)])
    lines += [r"\bottomrule", r"\end{tabular}", rf"\caption{{{caption}}}", rf"\label{{tab:{grid.name}}}"]
    return "\n".join([*lines, r"\end{table*}"]) + "\n"


def as_html(document: Document) -> str:
    """A page of its own; each of our numbers links to its runs, named by their seeds."""
    grid = document.grid
    rows = ["<thead><tr>"]
    rows += [f"<th>{html.escape(name)}</th>" for name in _headings(grid)]
    rows += [f'<th class="n">{html.escape(name)}</th>' for name in grid.columns]
    rows.append("</tr></thead>")
    for block in grid.blocks:
        rows.append("<tbody>")
        for line, names in zip(block, _names(grid, block), strict=True):
            row = "".join(f"<td>{html.escape(name)}</td>" for name in names)
            row += "".join(f'<td class="n">{_html_cell(document, cell)}</td>' for cell in line.cells)
            rows.append(f"<tr class={'quiet' if _is_quiet(line) else 'method'}>{row}</tr>")
        rows.append("</tbody>")
    notes = "".join(f"<li>{html.escape(note)}</li>\n" for note in document.notes)
    title = html.escape(grid.title)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head>\n<body><div><table><caption>{title}</caption>\n"
        + "\n".join(rows)
        + f"\n</table></div>\n<ul>\n{notes}</ul>\n</body></html>\n"
    )


def _headings(grid: Grid) -> list[str]:
    return ["Method", "Metric", "By"] if grid.has_metric_column else ["Method", "By"]


def _names(grid: Grid, block: Sequence[Line]) -> list[list[str]]:
    """The cells on the left of each line: a method and a metric are named once."""
    named = []
    method: str | None = None
    metric: str | None = None
    for line in block:
        title = heading(line.metric) if line.metric is not None else ""
        names = ["" if line.method == method else line.method]
        names += ["" if title == metric else title] if grid.has_metric_column else []
        named.append([*names, line.by])
        method, metric = line.method, title
    return named


def _is_quiet(line: Line) -> bool:
    """Lines that are no method of the paper's or ours, but marks to compare with."""
    return line.by in (ELSEWHERE, COMPUTED)


def _plain(cell: GridCell) -> str:
    return cell.text + (f" ({cell.n})" if cell.n else "") + cell.mark


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("_", "\\_").replace("<", "&lt;")


def _markdown_cell(document: Document, cell: GridCell, quiet: bool) -> str:
    text = _escaped(cell.text)
    if not text:
        return ""
    text = f"**{text}**" if cell.best else f"*{text}*" if quiet else text
    links = " ".join(f"[{seed}](<{document.link(run)}>)" for seed, run in cell.runs)
    return text + _behind(cell, links) + cell.mark


def _html_cell(document: Document, cell: GridCell) -> str:
    text = html.escape(cell.text)
    links = " ".join(f'<a href="{html.escape(document.link(run))}">{seed}</a>' for seed, run in cell.runs)
    return (f"<b>{text}</b>" if cell.best else text) + _behind(cell, links) + cell.mark


def _behind(cell: GridCell, links: str) -> str:
    """Number of runs, and links to them."""
    return f" ({': '.join(part for part in (str(cell.n) if cell.n else '', links) if part)})" if cell.n or links else ""


def _latex_cell(cell: GridCell, quiet: bool) -> str:
    text = _latex(_plain(cell))
    if not text:
        return ""
    return rf"\textbf{{{text}}}" if cell.best else rf"\textit{{{text}}}" if quiet else text


def _latex(text: str) -> str:
    return "".join(_LATEX.get(character, character) for character in text)
