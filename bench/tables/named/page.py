"""A named table as a page of HTML that works from a file, in light and dark, without anything from elsewhere."""

from __future__ import annotations

import html

from bench.tables.named.grid import GridCell
from bench.tables.named.layout import Document, is_quiet, left_headings, left_names

_STYLE = (
    ":root{color-scheme:light dark}"
    "body{font:12.5px/1.45 system-ui,sans-serif;margin:1.5rem;background:Canvas;color:CanvasText}"
    "h1{font-size:1.2rem;margin:0 0 .8rem}"
    "table{border-collapse:collapse;border-top:2px solid;border-bottom:2px solid}"
    "th,td{padding:.1rem .38rem;white-space:nowrap;font-variant-numeric:tabular-nums}"
    "th{text-align:left;font-weight:600;vertical-align:bottom}.n{text-align:right}"
    "th small{display:block;font-weight:400;opacity:.75}"
    "tbody th{white-space:normal;max-width:9rem;vertical-align:top;font-weight:400}"
    "thead{border-bottom:1px solid}tbody{border-top:1px solid #8886}"
    "tbody:hover{background:#8881}"
    "tr.quiet>*{color:GrayText;font-style:italic}"
    "td.n a{color:inherit;text-decoration-style:dotted}td.n span{opacity:.75;font-size:.85em}"
    "div{overflow-x:auto}ul{max-width:70rem;font-size:.88em;padding-left:1.2rem}"
    "@media print{body{margin:0}div{overflow:visible}}"
)


def as_html(document: Document) -> str:
    """The page; each of our numbers links to its runs, named by their seeds."""
    grid = document.grid
    rows = ["<thead><tr>"]
    rows += [f'<th scope="col">{html.escape(name)}</th>' for name in left_headings(grid)]
    rows += [f'<th scope="col" class="n">{_head(name)}</th>' for name in grid.columns]
    rows.append("</tr></thead>")
    for block in grid.blocks:
        rows.append("<tbody>")
        for number, (line, names) in enumerate(zip(block, left_names(grid, block), strict=True)):
            method = f'<th scope="rowgroup" rowspan="{len(block)}">{html.escape(names[0])}</th>'
            row = method if number == 0 else ""
            row += "".join(f"<td>{html.escape(name)}</td>" for name in names[1:])
            row += "".join(f'<td class="n">{_cell(document, cell)}</td>' for cell in line.cells)
            kind = "quiet" if is_quiet(line) else "ours" if line.by == "ours" else "others"
            rows.append(f'<tr class="{kind}">{row}</tr>')
        rows.append("</tbody>")
    notes = "".join(f"<li>{html.escape(note)}</li>\n" for note in document.notes)
    title = html.escape(grid.title)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n'
        f"<body><h1>{title}</h1>\n<div><table>\n"
        + "\n".join(rows)
        + f"\n</table></div>\n<ul>\n{notes}</ul>\n</body></html>\n"
    )


def _head(name: str) -> str:
    """A column's heading, with km and frames of ``03 (0.56/801)`` on a second line."""
    upper, bracket, lower = name.partition(" (")
    return html.escape(upper) + (f"<small>{html.escape(f'({lower}')}</small>" if bracket else "")


def _cell(document: Document, cell: GridCell) -> str:
    text = html.escape(cell.text)
    links = " ".join(f'<a href="{html.escape(document.link(run))}">{seed}</a>' for seed, run in cell.runs)
    parts = ": ".join(part for part in (str(cell.n) if cell.n else "", links) if part)
    return (f"<b>{text}</b>" if cell.best else text) + (f" <span>({parts})</span>" if parts else "") + cell.mark
