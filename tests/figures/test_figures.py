"""The paper's figures from runs whose pictures are known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from bench.cli import main
from bench.errors import BenchError
from bench.figures.chosen import Method, Shown, methods_of, shown_of
from bench.figures.grid import Cell, Grid, grid_figure
from bench.figures.paper import comparison, teaser
from bench.runs.folder import picture_path
from tests.evaluation.tiny_run import HEIGHT, WIDTH, TinyConfig, TinyDataset, write_tiny_run

CONFIG: dict[str, Any] = {"dataset": {"name": "tiny_for_tests"}, "protocol": {"lpips": False}, "system": "bgs_slam"}
NAN = float("nan")


@pytest.fixture
def runs(tmp_path: Path) -> list[Path]:
    return [write_tiny_run(tmp_path / name, CONFIG | {"system": name}) for name in ("one", "other")]


def methods(runs: list[Path]) -> list[Method]:
    return methods_of([str(run) for run in runs])


def test_comparison_has_the_saved_pictures_and_the_ground_truth_last(runs: list[Path]) -> None:
    shown, _ = shown_of(methods(runs), ["left", "right"], [13, 10], 2)
    assert shown == [Shown("left", 13), Shown("right", 13), Shown("left", 10), Shown("right", 10)]
    grid = comparison(methods(runs), shown, ["color", "depth"], NAN)
    assert list(grid.names) == ["one", "other", "Ground truth"]
    assert grid.headings[:4] == [
        "frame 13, left, held out",
        "frame 13, left, held out, depth",
        "frame 13, right, held out",
        "frame 13, right, held out, depth",
    ]
    assert grid.headings[4] == "frame 10, left"
    for row, run in enumerate(runs):
        saved = cv2.imread(str(picture_path(run, "right", "color", 10)))[..., ::-1]
        np.testing.assert_array_equal(grid.cells[row][6].picture, saved)
        np.testing.assert_array_equal(grid.cells[row][5].picture, np.full((HEIGHT, WIDTH), 10.0))
    frame = TinyDataset(TinyConfig()).frame(0)
    np.testing.assert_array_equal(grid.cells[2][4].picture, frame.left)
    np.testing.assert_array_equal(grid.cells[2][6].picture, frame.right)
    assert np.nanmax(grid.cells[2][5].picture) == pytest.approx(12.0)  # the LiDAR's
    assert (grid.cells[2][7].picture, grid.max_depth_m) == (None, pytest.approx(12.0))
    assert "left image alone" in grid.cells[2][7].note


def test_what_mapping_of_some_runs_did_not_see_is_marked_in_the_picture(runs: list[Path]) -> None:
    frames = pd.read_csv(runs[1] / "frames.csv")
    frames.loc[frames["number"] == 13, ["mapped", "heldout"]] = [True, False]
    frames.to_csv(runs[1] / "frames.csv", index=False)
    grid = comparison(methods(runs), [Shown("left", 13)], ["color"], NAN)
    assert [row[0].note for row in grid.cells] == ["held out", "", ""]
    assert (grid.headings, grid.max_depth_m) == (["frame 13, left"], None)
    with pytest.raises(BenchError, match=r"other has no heldout render of frame 13. All runs have heldout views of no"):
        shown_of(methods(runs), ["heldout"], [13], 2)


def test_teaser_has_methods_in_columns(runs: list[Path]) -> None:
    grid = teaser(methods_of([f"A={runs[0]}", str(runs[1])]), Shown("left", 11), 20.0)
    assert (grid.names, grid.headings, grid.max_depth_m) == (["Colour", "Depth"], ["A", "other"], 20.0)
    assert [cell.picture.ndim for row in grid.cells for cell in row if cell.picture is not None] == [3, 3, 2, 2]


def test_pictures_stand_where_they_belong_in_the_colours_of_their_depth() -> None:
    red, blue = np.full((2, 20, 40, 3), (255, 0, 0), np.uint8), np.full((20, 40, 3), (0, 0, 255), np.uint8)
    depth = np.full((20, 40), 15.0, np.float32)
    unknown = np.full((20, 40), NAN, np.float32)
    figure = grid_figure(
        Grid(["$a$", "b"], ["one", "two"], [[Cell(red[0]), Cell(depth)], [Cell(blue), Cell(unknown)]], 20.0), 2.0
    )
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    drawn = np.asarray(canvas.buffer_rgba())[..., :3]
    assert drawn.shape[1] == 600
    pictures = [axes.get_window_extent() for axes in figure.axes if axes.images]
    seen = [drawn[len(drawn) - round((e.y0 + e.y1) / 2), round((e.x0 + e.x1) / 2)].tolist() for e in pictures]
    turbo = [round(255 * part) for part in matplotlib.colormaps["turbo_r"](0.75)[:3]]
    np.testing.assert_allclose(seen, [[255, 0, 0], turbo, [0, 0, 255], [217, 217, 217]], atol=1)
    assert pictures[0].x0 < pictures[1].x0 and pictures[0].y0 > pictures[2].y0  # noqa: PT018


def test_the_command_writes_both_forms_and_the_same_bytes_again(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        assert main(["figure", "comparison", *map(str, runs), "--out", str(tmp_path / name), "--width", "3.3"]) == 0
    assert cv2.imread(str(tmp_path / "a.png")).shape[1] == 990
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    for form in ("png", "pdf"):
        assert (tmp_path / f"a.{form}").read_bytes() == (tmp_path / f"b.{form}").read_bytes()
    assert "All runs have left views of frames 10 to 11, 13 to 14. Shown: 11 left, 14 left." in capsys.readouterr().out


def _shrink(run: Path) -> None:
    for what in ("color", "depth"):
        path = str(picture_path(run, "left", what, 11))
        cv2.imwrite(path, cv2.imread(path, cv2.IMREAD_UNCHANGED)[::2, ::2])


def _other_images(run: Path) -> None:
    config = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(config.replace("tiny_for_tests", "street"))


@pytest.mark.parametrize(
    ("spoil", "arguments", "text"),
    [
        (None, ["--frames", "12"], "one has no left render of frame 12. All runs have left views of frames 10"),
        (None, ["--max-depth", "0"], "--max-depth must be above 0"),
        (None, ["--out", "x.jpg"], "must end in .png or .pdf"),
        (None, ["no_such_run"], "There is no run folder no_such_run"),
        (None, ["A=ONE", "A=ONE"], "Two runs are called A. Give them names"),
        (_shrink, ["--frames", "11"], "not of one size: 56x40 in"),
        (_other_images, ["--frames", "11"], "were made from different images: frame 11"),
    ],
)
def test_what_can_not_be_shown(
    runs: list[Path],
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[Path], None] | None,
    arguments: list[str],
    text: str,
) -> None:
    if spoil is not None:
        spoil(runs[1])
    given = [argument.replace("ONE", str(runs[0])) for argument in arguments]
    assert main(["figure", "comparison", *map(str, runs), *given]) == 2
    assert text in capsys.readouterr().err
