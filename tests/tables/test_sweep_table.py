"""The table of a sweep: a column for each setting that differs, runs that differ in the seed alone in one row."""

from __future__ import annotations

import csv
import statistics
from pathlib import Path
from typing import Any

import pytest
from fake_runs import config, make_run, metrics

from bench.cli import main
from bench.tables.collect import Row, collect_row
from bench.tables.document.forms import text_of
from bench.tables.groups import group_runs
from bench.tables.render import runs_document


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")


def run(name: str, psnr_db: float = 20.0, state: str = "done", **settings: Any) -> Row:
    scores = metrics(1101, psnr_db=psnr_db) if state == "done" else None
    return collect_row(make_run(Path("runs") / name, config(**settings), scores, state))


def told(rows: list[Row]) -> list[str]:
    return [column.title for column in group_runs(rows).settings]


def test_seeds_are_averaged_and_settings_are_columns() -> None:
    """Three seeds of each of two iterations: the mean and the sample deviation by the standard library."""
    values = {3: (20.0, 21.0, 24.0), 9: (30.0, 30.5, 31.5)}
    rows = [
        run(f"r{n}{seed}", psnr, seed=seed, mapper__iterations=n) for n in values for seed, psnr in enumerate(values[n])
    ]
    document = runs_document(rows)
    read = list(csv.DictReader(text_of(document, "csv", Path()).splitlines()))
    assert [(row["mapper.iterations"], row["n"], row["seeds"]) for row in read] == [
        ("3", "3", "0 1 2"),
        ("9", "3", "0 1 2"),
    ]
    for row, of in zip(read, values.values(), strict=True):
        assert float(row["psnr_db"]) == pytest.approx(statistics.mean(of))
        assert float(row["psnr_db_std"]) == pytest.approx(statistics.stdev(of))
    text = text_of(document, "md", Path())
    assert "21.67 ± 2.08" in text
    assert "30.67 ± 0.76" in text
    assert "- Runs of mapper.iterations=3: [0](<runs/r30>) [1](<runs/r31>) [2](<runs/r32>)" in text
    assert told(rows) == ["mapper.iterations"]


@pytest.mark.parametrize(
    ("one", "other", "columns"),
    [
        ({"stereo": "sgbm", "stereo__scale": 1.0}, {"stereo": "psmnet", "stereo__scale": 0.5}, []),
        ({"losses": ("rgb", "ssim")}, {"losses": ("rgb", "ssim", "geo")}, ["loss"]),
        ({"sky": "none"}, {"sky": "horizon"}, ["sky"]),
        ({"system": "bgs_slam", "mapper__iterations": 60}, {"mapper__iterations": 9}, []),
        ({"loss__geo__weight": 0.1}, {"loss__geo__weight": 0.2}, ["loss.geo.weight"]),
        ({"protocol__alignment": "none"}, {}, []),
        ({"threads": 1}, {"threads": 2}, []),
        ({"dataset__frames": "0:10"}, {"dataset__frames": "0:20"}, ["dataset.frames"]),
    ],
)
def test_what_a_column_shows_or_another_choice_brings_is_told_once(
    one: dict[str, Any], other: dict[str, Any], columns: list[str]
) -> None:
    """System, stereo, tracker and data set have columns already; `scale` comes with the backbone."""
    rows = [run("a", **one), run("b", **other)]
    assert told(rows) == columns
    assert len(group_runs(rows).rows) == 2


def test_only_runs_that_ended_alike_with_different_seeds_are_averaged() -> None:
    rows = [run("a", seed=0), run("b", seed=1), run("c", seed=2, state="failed")]
    assert [(row.values["n"], row.values["status"]) for row in group_runs(rows).rows] == [(2, "done"), (1, "failed")]
    again = [run("d", seed=0), run("e", seed=0)]
    assert [row.values["run"] for row in group_runs(again).rows] == ["d", "e"]


def test_the_command_orders_a_folder_by_its_settings(capsys: pytest.CaptureFixture[str]) -> None:
    """The folders' names, hashes, say nothing; 9 comes before 10."""
    for name, iterations in (("a", 10), ("b", 9), ("c", 100)):
        for seed in (0, 1):
            run(f"{name}{seed}", seed=seed, mapper__iterations=iterations)
    assert main(["table", "runs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("│")[2].strip() for line in lines if "2 runs" in line] == ["9", "10", "100"]
    assert lines[-1] == "mapper.iterations=100, seed 1: runs/c1"


def test_weak_and_lost_frames_stand_beside_the_frames() -> None:
    scores = metrics(1101, psnr_db=20.0) | {
        "frames": {"total": 1101, "tracked": 1099, "weak": 7, "predicted": 3, "lost": 2}
    }
    text = text_of(runs_document([collect_row(make_run(Path("a"), config(), scores))]), "md", Path())
    assert "| Status | Frames | Weak | Predicted | Lost |" in text
    assert "| done, 2 frames lost | 1099/1101 | 7 | 3 | 2 |" in text
