"""Two runs beside each other, from numbers that were written down by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from fake_runs import config, make_run, metrics

from bench.cli import main
from bench.tables.pair import differing_settings, frame_pairs, metric_pairs, why_not_comparable
from bench.tables.records.folder import read_run
from bench.tables.records.record import RunRecord

FRAMES = {10: (20.0, 25.0), 11: (21.0, 20.5), 12: (22.0, 22.0), 13: (23.0, None)}


def made(folder: Path, column: int, scores: dict[str, Any] | None = None, **settings: Any) -> Path:
    """A run of sequence 06 whose PSNR of each left frame is in ``FRAMES``."""
    psnr, ate = ((20.5, 0.2), (24.5, 0.1))[column]
    run = make_run(folder, config("06", **settings), metrics(1101, psnr_db=psnr, ate_rmse_m=ate) | (scores or {}))
    rows = [f"left,{n},{'' if values[column] is None else values[column]}" for n, values in FRAMES.items()]
    (run / "per_frame.csv").write_text("\n".join(["view,number,psnr_db", *rows, "right,10,9.0", ""]))
    (run / "frames.csv").write_text("number,timestamp,state,mapped,heldout,images_crc32\n10,1,ok,True,False,77\n")
    return run


@pytest.fixture
def a(tmp_path: Path) -> Path:
    return made(tmp_path / "a", 0)


def records(*runs: Path) -> list[RunRecord]:
    return [read_run(run) for run in runs]


def test_settings_metrics_and_frames(a: Path, tmp_path: Path) -> None:
    one, other = records(a, made(tmp_path / "b", 1, seed=2, stereo="psmnet", mapper__iterations=80))
    assert differing_settings(one, other) == [
        ("mapper.iterations", "60", "80"),
        ("seed", "0", "2"),
        ("stereo.name", "sgbm", "psmnet"),
    ]
    assert why_not_comparable(one, other) == []
    found = {each.metric.key: (each.a, each.b, each.better) for each in metric_pairs(one, other)}
    assert found == {"ate_rmse_m": (0.2, 0.1, "B"), "psnr_db": (20.5, 24.5, "B")}
    left, right = frame_pairs(one, other, "psnr_db")
    assert (left.camera, left.a_better, left.b_better, left.equal) == ("left", 1, 1, 1)
    assert left.largest == ((10, 20.0, 25.0), (11, 21.0, 20.5))
    assert (right.camera, right.equal, right.largest) == ("right", 1, ())


@pytest.mark.parametrize(
    ("scores", "settings", "reason"),
    [
        ({"protocol": {"name": "paper", "alignment": "none"}}, {}, "protocol: alignment se3 and none"),
        ({"frames": {"total": 300}}, {}, "frames done: 1101 and 300"),
        (None, {"dataset__frames": "0:10"}, "data: dataset.frames  and 0:10"),
        (None, {"dataset__sequence": "03"}, "data: dataset.sequence 06 and 03"),
    ],
)
def test_what_can_not_be_compared(
    a: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    scores: dict[str, Any] | None,
    settings: dict[str, Any],
    reason: str,
) -> None:
    b = made(tmp_path / "b", 1, scores, **settings)
    assert reason in why_not_comparable(*records(a, b))
    assert main(["compare", str(a), str(b)]) == 2
    said = capsys.readouterr()
    assert f"can't be compared: {reason}" in said.err
    assert "PSNR" not in said.out


def test_other_images_of_the_same_name_and_other_right_views(a: Path, tmp_path: Path) -> None:
    b = made(tmp_path / "b", 1, {"protocol": {"name": "mine", "alignment": "se3", "right_images_mapped": True}})
    assert why_not_comparable(*records(a, b)) == []  # a protocol's name is no rule
    assert [each.camera for each in frame_pairs(*records(a, b), "psnr_db")] == ["left"]
    (b / "frames.csv").write_text((b / "frames.csv").read_text().replace("77", "78"))
    assert why_not_comparable(*records(a, b)) == ["data: the images of frame 10 are not the same"]


def test_the_command(a: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    b = made(tmp_path / "b", 1, system="<script>[red]")
    assert main(["compare", str(a), str(b)]) == 0
    printed = capsys.readouterr().out
    assert "<script>[red]" in printed
    assert "PSNR of left views: A is better in 1, B in 1, equal in 1" in printed
    assert "+4.00" in next(line for line in printed.splitlines() if line.startswith("│ PSNR [dB]"))
    assert main(["compare", str(a), str(b), "--by", "psnr"]) == 2
    assert "--by='psnr' is not one of psnr_db. Did you mean 'psnr_db'?" in capsys.readouterr().err
    assert main(["compare", str(a), str(tmp_path)]) == 2
    assert "is a folder of 2 runs. Give two run folders." in capsys.readouterr().err
