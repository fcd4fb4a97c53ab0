"""A grid of pictures as PNG and PDF: names at the left, headings above, one colour bar for all depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from bench.errors import BenchError
from bench.figures.depth_colors import colored, depth_scale
from bench.io.atomic import atomic_path
from bench.types import Image, Map

FORMS = (".png", ".pdf")
_DPI = 300
_GAP_IN, _NAME_IN, _HEADING_IN, _BAR_IN, _BAR_BELOW_IN = 0.03, 0.16, 0.15, 0.08, 0.3
_FONT_PT, _LETTER_EM = 7.0, 0.62


@dataclass(frozen=True)
class Cell:
    """A colour image (H, W, 3) uint8, a depth map (H, W) in metres (NaN: unknown), or None; and words on it."""

    picture: Image | Map | None
    note: str = ""


@dataclass(frozen=True)
class Grid:
    """``cells[row][column]``; colours of depth go from 0 to ``max_depth_m``, and beyond have the last one."""

    names: Sequence[str]
    headings: Sequence[str]
    cells: Sequence[Sequence[Cell]]
    max_depth_m: float | None
    """None where there is no depth to show: then there is no bar."""


def files_of(out: Path) -> list[Path]:
    """What is written for ``--out``: that file, or without an ending both forms; ``BenchError`` for another form."""
    if out.suffix in FORMS:
        return [out]
    if out.suffix:
        raise BenchError(f"--out {out} must end in {' or '.join(FORMS)}, or have no ending for both.")
    return [out.with_name(f"{out.name}{form}") for form in FORMS]


def write_grid(path: Path, grid: Grid, width_in: float) -> None:
    """Draw it ``width_in`` inches wide at 300 dots per inch, whole or not at all; equal grids give equal bytes."""
    figure = grid_figure(grid, width_in)
    # Without the time, and with fonts that publishers take.
    with rc_context({"pdf.fonttype": 42}), atomic_path(path) as temporary:
        if path.suffix == ".pdf":
            figure.savefig(temporary, format="pdf", dpi=_DPI, metadata={"CreationDate": None})
        else:
            figure.savefig(temporary, format="png", dpi=_DPI, metadata={"Software": None})


def grid_figure(grid: Grid, width_in: float) -> Figure:
    """The figure; each column is as wide as the others, each row as high as its pictures."""
    columns = len(grid.headings)
    cell_in = (width_in - _NAME_IN) / columns - _GAP_IN
    shape = next(cell.picture.shape for row in grid.cells for cell in row if cell.picture is not None)
    row_in = cell_in * shape[0] / shape[1]
    below_in = 0.0 if grid.max_depth_m is None else _BAR_IN + _BAR_BELOW_IN + 2 * _GAP_IN
    height_in = _HEADING_IN + len(grid.cells) * (row_in + _GAP_IN) + below_in
    figure = Figure(figsize=(width_in, height_in), dpi=_DPI)
    FigureCanvasAgg(figure)
    depths = depth_scale(grid.max_depth_m)
    name_pt = _size_of(grid.names, row_in)
    for row, (name, cells) in enumerate(zip(grid.names, grid.cells, strict=True)):
        bottom = height_in - _HEADING_IN - (row + 1) * (row_in + _GAP_IN) + _GAP_IN
        _write(figure, name, (_NAME_IN / 2, bottom + row_in / 2), name_pt, rotation=90)
        for column, cell in enumerate(cells):
            left = _NAME_IN + column * (cell_in + _GAP_IN)
            _draw(figure, cell, (left, bottom, cell_in, row_in), depths)
    heading_pt = _size_of(grid.headings, cell_in)
    for column, heading in enumerate(grid.headings):
        left = _NAME_IN + column * (cell_in + _GAP_IN)
        _write(figure, heading, (left + cell_in / 2, height_in - _HEADING_IN / 2), heading_pt)
    if grid.max_depth_m is not None:
        box = (_NAME_IN / 2 + width_in / 4, _BAR_BELOW_IN, width_in / 2, _BAR_IN)
        axes = figure.add_axes(_share(figure, box))
        bar = figure.colorbar(depths, cax=axes, orientation="horizontal", extend="max")
        bar.ax.tick_params(labelsize=_FONT_PT - 1, length=2, pad=1)
        bar.set_label("depth [m]; grey: unknown", fontsize=_FONT_PT - 1, labelpad=0)
        bar.outline.set_linewidth(0.4)
    return figure


def _share(figure: Figure, box_in: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Left, bottom, width and height as shares of the figure's."""
    width, height = figure.get_size_inches()
    return box_in[0] / width, box_in[1] / height, box_in[2] / width, box_in[3] / height


def _size_of(texts: Sequence[str], room_in: float) -> float:
    """Points at which each of the texts fits into so many inches."""
    return min(_FONT_PT, 72 * room_in / (_LETTER_EM * max(1, *map(len, texts))))


def _write(figure: Figure, text: str, middle_in: tuple[float, float], size: float, rotation: float = 0) -> None:
    x, y, _, _ = _share(figure, (*middle_in, 0.0, 0.0))
    # What others wrote is no formula.
    figure.text(x, y, text, size=size, rotation=rotation, ha="center", va="center", parse_math=False)


def _draw(figure: Figure, cell: Cell, box_in: tuple[float, float, float, float], depths: ScalarMappable) -> None:
    axes = figure.add_axes(_share(figure, box_in))
    axes.set_axis_off()
    if cell.picture is not None:
        is_depth = cell.picture.ndim == 2
        axes.imshow(colored(cell.picture.astype(np.float32), depths) if is_depth else cell.picture, aspect="auto")
    if cell.note:
        axes.text(
            *(0.01, 0.96, cell.note),
            size=_FONT_PT - 2,
            transform=axes.transAxes,
            va="top",
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1},
            parse_math=False,
        )
