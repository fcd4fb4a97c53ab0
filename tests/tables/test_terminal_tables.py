"""Named tables on terminals of different widths, and piped."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from fake_runs import FRAMES, config, make_run, metrics
from rich.console import Console

from bench.tables.named.table import PaperTable, make_table


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def table(tmp_path: Path) -> PaperTable:
    for sequence, frames in FRAMES.items():
        for seed in (0, 1):
            scores = metrics(frames, psnr_db=20.0 + seed, depth_l1_cm=1000.0 + seed, ate_rmse_m=100.0 + seed)
            make_run(tmp_path / f"{sequence}_{seed}", config(sequence, seed=seed), scores)
    return make_table("main_kitti", [tmp_path])


def printed(table: PaperTable, width: int, terminal: bool) -> list[str]:
    """The lines of the boxes."""
    text = io.StringIO()
    table.print(Console(file=text, width=width, force_terminal=terminal))
    without_codes = re.sub(r"\x1b\[[0-9;]*m", "", text.getvalue())
    return [line for line in without_codes.splitlines() if line[:1] in set("┏┃┡│├└")]


@pytest.mark.parametrize(("width", "boxes"), [(100, 4), (160, 2), (250, 1)])
def test_a_narrow_terminal_gets_the_table_in_parts(table: PaperTable, width: int, boxes: int) -> None:
    lines = printed(table, width, terminal=True)
    assert max(map(len, lines)) <= width
    assert sum(line.startswith("┏") for line in lines) == boxes
    text = "\n".join(lines)
    for sequence in FRAMES:
        assert text.count(f" {sequence} ┃") == 1
    assert text.count("BGS-SLAM (Ours)") == boxes, "each part names the methods"
    assert text.count("20.50 ± 0.71 (2)") == 7


@pytest.mark.slow
def test_what_is_piped_is_one_table(table: PaperTable) -> None:
    lines = printed(table, 80, terminal=False)
    assert sum(line.startswith("┏") for line in lines) == 1
    assert len({len(line) for line in lines}) == 1
