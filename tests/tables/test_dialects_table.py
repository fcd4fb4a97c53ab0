"""The table of dialects from run folders with known numbers."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest
from fake_runs import config, make_run, metrics

from bench.cli import main
from bench.errors import BenchError
from bench.tables.document.forms import FORMS
from bench.tables.named.table import make_table


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No results/runs of whoever runs the tests."""
    monkeypatch.chdir(tmp_path)


def dialect(n_views: int, **values: float | None) -> dict[str, Any]:
    return {"n_views": n_views, **values, "stamp": {"views": "some", "psnr": "masked", "lpips_weights_sha256": "7b38"}}


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Two seeds of one system: ours 20 and 22 dB, SplaTAM's rules 33.5 and 34.5 dB, MonoGS's rules once 21.25 dB."""
    for name, seed, ours, splatam, monogs in (("a", 0, 20.0, 33.5, 21.25), ("b", 1, 22.0, 34.5, None)):
        scores = metrics(801, psnr_db=ours, ssim=0.75, ate_rmse_m=2.0, depth_l1_cm=100.0)
        scores["dialects"] = {
            "splatam": dialect(3, psnr_db=splatam, ssim=0.95, lpips=None, depth_l1_cm=40.0, ate_m=1.25),
            "monogs": dialect(1 + seed, psnr_db=monogs, ssim=0.5, lpips=0.25, depth_l1_cm=None, ate_m=None),
        }
        scores["notes"] = {"dialects": "monogs: the keyframes lie on a straight line"}
        make_run(tmp_path / "runs" / name, config("03", seed=seed), scores)
    make_run(tmp_path / "runs" / "plain", config("06"), metrics(1101, psnr_db=20.0))
    return tmp_path / "runs"


def rows_of(markdown: str) -> list[list[str]]:
    lines = [line for line in markdown.splitlines() if line.startswith("|") and not line.startswith("|-")]
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]


def test_ours_comes_first_and_each_dialect_shows_its_difference(runs: Path) -> None:
    table = make_table("dialects", [runs])
    head, *rows = rows_of(table.text("md", runs))
    assert head == ["Method", "By", "PSNR [dB] ↑", "SSIM ↑", "LPIPS ↓", "Depth-L1 [cm] ↓", "ATE [m] ↓"]
    without_links = [[re.sub(r" \((\d): .*?\)\)", r" (\1)", cell) for cell in row] for row in rows]
    # 20 and 22: mean 21, deviation sqrt(2). 13.5 and 12.5 more: 13 more. Only the first has MonoGS's PSNR, 1.25 more.
    blocks = {row[1]: row[2:] for row in without_links}
    assert [row[0] for row in without_links] == ["bgs\\_slam\\_paper kitti 03", "", ""]
    assert blocks["ours"] == ["21.00 ± 1.41 (2)", "0.750 ± 0.000 (2)", "-", "100.0 ± 0.0 (2)", "2.000 ± 0.000 (2)"]
    splatam = ["34.00 ± 0.71 (+13.00)", "0.950 ± 0.000 (+0.200)", "-", "40.0 ± 0.0 (\u221260.0)"]
    assert blocks["splatam"] == [*splatam, "1.250 ± 0.000 (\u22120.750)"]
    monogs = ["21.25 (+1.25) (1)", "0.500 ± 0.000 (\u22120.250)", "0.250 ± 0.000", "-", "-"]
    assert blocks["monogs"] == monogs


def test_systems_sequences_and_settings_are_not_mixed(runs: Path) -> None:
    """A third seed with other settings is a block of its own, and both say what tells them apart."""
    scores = metrics(801, psnr_db=10.0)
    scores["dialects"] = {"splatam": dialect(3, psnr_db=11.0)}
    made = [config("03", seed=2, mapper__iterations=5), config("03", seed=2, stereo="lidar"), config("06", seed=2)]
    for number, one in enumerate(made):
        make_run(runs / f"c{number}", one, scores if number < 2 else scores | {"frames": {"total": 1101}})
    text = make_table("dialects", [runs]).text("csv", runs)
    ours = {
        row["of"]: (float(row["value"]), row["n"], row["seeds"])
        for row in csv.DictReader(io.StringIO(text))
        if row["by"] == "ours" and row["metric"] == "psnr_db"
    }
    assert ours == {
        "bgs_slam_paper kitti 03 (mapper.iterations 60, stereo sgbm)": (21.0, "2", "0 1"),
        "bgs_slam_paper kitti 03 (mapper.iterations 5, stereo sgbm)": (10.0, "1", "2"),
        "bgs_slam_paper kitti 03 (mapper.iterations 60, stereo lidar)": (10.0, "1", "2"),
        "bgs_slam_paper kitti 06": (10.0, "1", "2"),
    }


def test_notes_say_the_rules_the_views_and_what_is_missing(runs: Path) -> None:
    notes = make_table("dialects", [runs]).notes
    assert "Rules of splatam: views: some; psnr: masked." in notes
    assert "bgs_slam_paper kitti 03: 801 frames; seeds 0, 1; views scored: splatam 3, monogs 1/2." in notes
    where = "bgs_slam_paper kitti 03, seed 0, bgs_slam_paper kitti 03, seed 1"
    assert f"{where}: dialects: monogs: the keyframes lie on a straight line" in notes
    assert any(note.startswith("1 run was not scored by dialects") for note in notes)
    assert any(note.startswith("Protocol: name paper") for note in notes)


def test_every_format_and_full_digits_in_csv(runs: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["table", "dialects", str(runs), "--out", str(tmp_path / "out")]) == 0
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == sorted(
        f"dialects.{form}" for form in (*FORMS, "runs.json")
    )
    text = (tmp_path / "out" / "dialects.csv").read_text()
    rows = {(row["by"], row["metric"]): row for row in csv.DictReader(io.StringIO(text))}
    assert len(rows) == 15
    found = rows["splatam", "psnr_db"]
    assert (found["value"], found["difference"], found["n_views"], found["n"]) == ("34.0", "13.0", "3", "2")
    assert (rows["monogs", "ate_rmse_m"]["value"], rows["ours", "ate_rmse_m"]["value"]) == ("", "2.0")
    assert found["runs"] == "dialects.runs.json#L9 dialects.runs.json#L10"
    assert (tmp_path / "out" / "dialects.tex").read_text().isascii()
    assert "splatam" in capsys.readouterr().out


def test_without_runs_it_says_how_to_get_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", "dialects", "--format", "md"]) == 0
    printed = capsys.readouterr().out
    assert rows_of(printed)[1:] == []
    assert "No run here was scored by dialects; add the evaluator 'dialects'" in printed
    with pytest.raises(BenchError, match="There is no folder"):
        make_table("dialects", [Path("nowhere")])


def test_a_wrong_name_finds_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", "dialect"]) == 2
    assert "Did you mean 'dialects'?" in capsys.readouterr().err
