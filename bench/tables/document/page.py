"""A document as a page of HTML that works from a file, in light and dark, without anything from elsewhere."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

from bench.plain_text import plain_line
from bench.tables.document.model import Cell, Column, Document, Row

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
    "li a{color:inherit;text-decoration-style:dotted}td.n span{opacity:.75;font-size:.85em}"
    "div{overflow-x:auto}ul{max-width:70rem;font-size:.88em;padding-left:1.2rem}"
    "@media print{body{margin:0}div{overflow:visible}}"
)


def as_html(document: Document) -> str:
    """The page, with links to the runs below its notes."""
    title = _text(document.title or document.name)
    heads = [_head(column) for column in (*document.left, *document.columns)]
    rows = ["<thead><tr>", *heads, "</tr></thead>"]
    for block in document.blocks:
        rows.append("<tbody>")
        rows += [_row(document, row, _reach(block[number:])) for number, row in enumerate(block)]
        rows.append("</tbody>")
    notes = "".join(f"<li>{_text(note)}</li>\n" for note in document.notes)
    notes += "".join(f"<li>Runs of {_text(of)}: {_links(document, runs)}</li>\n" for of, runs in document.links)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n'
        f"<body><h1>{title}</h1>\n<div><table>\n"
        + "\n".join(rows)
        + f"\n</table></div>\n<ul>\n{notes}</ul>\n</body></html>\n"
    )


def _text(text: str) -> str:
    return html.escape(plain_line(text))


def _head(column: Column) -> str:
    lower = f"<small>{_text(column.below)}</small>" if column.below else ""
    return f'<th scope="col"{_class(column)}>{_text(column.title)}{lower}</th>'


def _reach(rows: Sequence[Row]) -> int:
    """How many rows the first one's first name stands for."""
    others = (place for place, row in enumerate(rows[1:], 1) if row.names[0])
    return next(others, len(rows))


def _row(document: Document, row: Row, reach: int) -> str:
    first, *others = row.names
    name = f'<th scope="rowgroup" rowspan="{reach}">{_text(first)}</th>' if first else ""
    name += "".join(f"<td>{_text(each)}</td>" for each in others)
    columns = zip(document.columns, row.cells, strict=True)
    cells = "".join(f"<td{_class(column)}>{_cell(cell)}</td>" for column, cell in columns)
    return f'<tr class="{row.kind}">{name}{cells}</tr>'


def _class(column: Column) -> str:
    return ' class="n"' if column.align == "right" else ""


def _cell(cell: Cell) -> str:
    text = _text(cell.text)
    return (f"<b>{text}</b>" if cell.best else text) + (f" <span>({cell.n})</span>" if cell.n else "") + cell.mark


def _links(document: Document, runs: Sequence[tuple[str, Path]]) -> str:
    places = ((name, html.escape(document.link(place))) for name, place in runs)
    return " ".join(f'<a href="{place}">{_text(name)}</a>' for name, place in places)
