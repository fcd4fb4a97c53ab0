"""The paper's two figures of results: the teaser and the comparison, of any runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from bench.errors import BenchError
from bench.figures.chosen import Method, Shown, is_held_out
from bench.figures.depth_colors import known_depth, limit_of
from bench.figures.grid import Cell, Grid
from bench.types import Map

What = Literal["color", "depth"]
WHATS: tuple[What, ...] = ("color", "depth")
TRUTH = "Ground truth"


def comparison(methods: Sequence[Method], shown: Sequence[Shown], whats: Sequence[What], max_depth_m: float) -> Grid:
    """Methods in rows and views in columns, colour and depth beside each other, the ground truth in the last row.

    ``max_depth_m`` NaN: the 95 % quantile of the depth that is known of the left images, else of what is rendered.
    Raises ``BenchError`` where pictures are missing or of several sizes.
    """
    columns = [(each, what) for each in shown for what in whats]
    rows = [[_rendered(method, *column) for column in columns] for method in methods]
    rows = _with_held_out_marks(methods, columns, rows)
    truth = [_truth(methods[0], each, what) for each, what in columns]
    _require_one_size([*methods, methods[0]], [*rows, truth])
    headings = [_heading(methods, each, what) for each, what in columns]
    limit = _limit(methods[0], shown, rows, max_depth_m) if "depth" in whats else None
    return Grid([*(method.name for method in methods), TRUTH], headings, [*rows, truth], limit)


def teaser(methods: Sequence[Method], shown: Shown, max_depth_m: float) -> Grid:
    """Methods in columns: the render of one view above its depth, as the paper's first figure."""
    rows = [[_rendered(method, shown, what) for method in methods] for what in WHATS]
    _require_one_size(methods, list(zip(*rows, strict=True)))
    return Grid(
        ["Colour", "Depth"], [method.name for method in methods], rows, _limit(methods[0], [shown], rows, max_depth_m)
    )


def _rendered(method: Method, shown: Shown, what: What) -> Cell:
    run = method.run
    picture = run.render(shown.camera, shown.number) if what == "color" else run.depth(shown.camera, shown.number)
    if picture is None and what == "color":
        raise BenchError(f"{run.path} has no {shown.camera} render of frame {shown.number}. Choose others by --frames.")
    return Cell(picture, "no depth saved" if picture is None else "")


def _truth(method: Method, shown: Shown, what: What) -> Cell:
    """The data set's image, or what it knows of the depth of the left one."""
    if what == "color":
        frame = method.run.frame(method.run.position_of(shown.number))
        is_left = shown.camera == "left"
        return Cell(frame.left if is_left else frame.pair("The figure of right views", "--views left")[1])
    if shown.camera == "right":
        return Cell(None, "depth is known in the left image alone")
    depth = _known_depth(method, shown.number)
    return Cell(depth, "no depth known" if depth is None else "")


def _limit(method: Method, shown: Sequence[Shown], rows: Sequence[Sequence[Cell]], max_depth_m: float) -> float | None:
    """Metres at which the colours of depth end; None where no depth is known."""
    pictures = [cell.picture for row in rows for cell in row if cell.picture is not None]
    rendered = [picture.astype(np.float32) for picture in pictures if picture.ndim == 2]
    limit = limit_of([_known_depth(method, each.number) for each in shown], rendered)
    return limit if limit is None or np.isnan(max_depth_m) else max_depth_m


def _known_depth(method: Method, number: int) -> Map | None:
    return known_depth(method.run.dataset, method.run.position_of(number))


def _heading(methods: Sequence[Method], shown: Shown, what: What) -> str:
    held_out = all(is_held_out(method, shown.number) for method in methods)
    parts = [
        f"frame {shown.number}",
        shown.camera,
        *(["held out"] if held_out else []),
        *(["depth"] * (what == "depth")),
    ]
    return ", ".join(parts)


def _with_held_out_marks(
    methods: Sequence[Method], columns: Sequence[tuple[Shown, What]], rows: list[list[Cell]]
) -> list[list[Cell]]:
    """Where mapping of some runs alone saw a frame, the cells of the others say that it did not."""
    marked = [list(row) for row in rows]
    for column, (shown, what) in enumerate(columns):
        held_out = [is_held_out(method, shown.number) for method in methods]
        for row, is_out in enumerate(held_out):
            if is_out and not all(held_out) and what == "color":
                marked[row][column] = Cell(rows[row][column].picture, "held out")
    return marked


def _require_one_size(methods: Sequence[Method], rows: Sequence[Sequence[Cell]]) -> None:
    sizes: dict[tuple[int, ...], Method] = {}
    for method, row in zip(methods, rows, strict=True):
        for cell in row:
            if cell.picture is not None:
                sizes.setdefault(cell.picture.shape[1::-1], method)
    if len(sizes) > 1:
        said = ", ".join(f"{w}x{h} in {method.run.path}" for (w, h), method in sizes.items())
        raise BenchError(f"The pictures are not of one size: {said}. Choose runs with the same dataset.scale.")
