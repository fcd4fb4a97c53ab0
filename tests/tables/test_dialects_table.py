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
from bench.tables.named.table import FORMATS, make_table


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No results/runs of whoever runs the tests."""
    monkeypatch.chdir(tmp_path)


def dialect(n_views: int, **values: float | None) -> dict[str, Any]:
    return {"n_views": n_views, **values, "stamp": {"views": "some", "psnr": "masked", "lpips_weights_sha256": "7b38"}}


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    scores = metrics(801, psnr_db=20.0, ssim=0.75, ate_rmse_m=2.0, depth_l1_cm=100.0)
    scores["trajectory"]["ate_rmse_m"] = 2.0
    scores["dialects"] = {
        "splatam": dialect(3, psnr_db=33.5, ssim=0.95, lpips=None, depth_l1_cm=40.0, ate_m=1.25),
        "monogs": dialect(1, psnr_db=21.25, ssim=0.5, lpips=0.25, depth_l1_cm=None, ate_m=None),
    }
    scores["notes"] = {"dialects": "monogs: the keyframes lie on a straight line"}
    make_run(tmp_path / "runs" / "a", config("03"), scores)
    make_run(tmp_path / "runs" / "plain", config("06"), metrics(1101, psnr_db=20.0))
    return tmp_path / "runs"


def rows_of(markdown: str) -> list[list[str]]:
    lines = [line for line in markdown.splitlines() if line.startswith("|") and not line.startswith("|-")]
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]


def test_ours_comes_first_and_each_dialect_shows_its_difference(runs: Path) -> None:
    table = make_table("dialects", [runs])
    head, *rows = rows_of(table.text("md", runs))
    assert head == ["Method", "By", "PSNR [dB] ↑", "SSIM ↑", "LPIPS ↓", "Depth-L1 [cm] ↓", "ATE [m] ↓"]
    without_links = [[re.sub(r" \(\[0\]\(<.*?>\)\)", "", cell) for cell in row] for row in rows]
    assert without_links == [
        ["a", "ours", "20.00", "0.750", "-", "100.0", "2.000"],
        ["", "splatam", "33.50 (+13.50)", "0.950 (+0.200)", "-", "40.0 (\u221260.0)", "1.250 (\u22120.750)"],
        ["", "monogs", "21.25 (+1.25)", "0.500 (\u22120.250)", "0.250", "-", "-"],
    ]


def test_notes_say_the_rules_the_views_and_what_is_missing(runs: Path) -> None:
    notes = make_table("dialects", [runs]).notes
    assert "Rules of splatam: views: some; psnr: masked." in notes
    assert "a: views scored: splatam 3, monogs 1." in notes
    assert "a: dialects: monogs: the keyframes lie on a straight line" in notes
    assert any(note.startswith("1 run was not scored by dialects") for note in notes)
    assert any(note.startswith("Protocol: name paper") for note in notes)


def test_every_format_and_full_digits_in_csv(runs: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["table", "dialects", str(runs), "--out", str(tmp_path / "out")]) == 0
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == sorted(f"dialects.{form}" for form in FORMATS)
    text = (tmp_path / "out" / "dialects.csv").read_text()
    rows = {(row["by"], row["metric"]): row for row in csv.DictReader(io.StringIO(text))}
    assert len(rows) == 15
    found = rows["splatam", "psnr_db"]
    assert (found["value"], found["difference"], found["n_views"], found["run"]) == ("33.5", "13.5", "3", "a")
    assert (rows["monogs", "ate_rmse_m"]["value"], rows["ours", "ate_rmse_m"]["value"]) == ("", "2.0")
    assert (tmp_path / "out" / found["folder"]).resolve() == runs / "a"
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
