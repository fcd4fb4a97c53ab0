"""What a sweep shows: the time left, plain lines, and the live table."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from bench.config import RunConfig
from bench.sweeps import view
from bench.sweeps.job import Outcome
from bench.sweeps.lookup import Found
from bench.sweeps.plan import PlannedRun
from bench.sweeps.time_left import RunProgress, seconds_left
from bench.sweeps.view import SweepView, duration
from bench.tables.named.definitions import Cell


def planned(row: str, seed: int = 0, frames: int = 4, root: Path = Path("runs")) -> PlannedRun:
    return PlannedRun(Cell(row, "03", ()), seed, RunConfig({}, row), root / f"{row}-{seed}", (), frames)


def test_time_left_by_the_frames_and_the_times_of_each_kind() -> None:
    """ "slow" takes 6 s per frame (60 for 10), "fast" 1 s: of the first 4 frames of 10 are left, 24 s, of the second a
    whole run of 20. A kind of which nothing is known takes their mean, 3.5 s per frame: 10 frames, 35 s."""
    runs = [
        RunProgress("slow", "finished", 10, 10, 60.0),
        RunProgress("fast", "finished", 20, 20, 20.0),
        RunProgress("slow", "running", 10, 6, 30.0),
        RunProgress("fast", "waiting", 20),
        RunProgress("new", "waiting", 10),
        RunProgress("slow", "gone", 10),
    ]
    assert seconds_left(runs, 1) == pytest.approx(24 + 20 + 35)
    assert seconds_left(runs, 2) == pytest.approx((24 + 20 + 35) / 2)
    assert seconds_left(runs, 10) == pytest.approx(35)  # the longest run alone
    assert seconds_left(runs[3:], 1) is None


def test_a_first_run_is_judged_by_its_own_pace() -> None:
    """5 frames in 10 s: 2 s per frame; 15 are left, and a run of 20 waits."""
    runs = [RunProgress("one", "running", 20, 5, 10.0), RunProgress("one", "waiting", 20)]
    assert seconds_left(runs, 1) == pytest.approx(15 * 2 + 20 * 2)


def test_time_left_of_a_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of 10 and 30 s for 4 frames: 5 s per frame in the mean. One has run for 5 s, one for 50 s, both without a
    word; one failed, three wait: (15 + 0 + 3 * 20) / 2 = 37.5 s."""
    now = 100.0
    monkeypatch.setattr(view.time, "monotonic", lambda: now)
    runs = [planned(row) for row in "abcdefgh"]
    sweep = SweepView(Console(file=io.StringIO()), "ablation", runs, at_once=2)
    assert sweep.seconds_left() is None
    sweep.ended(Outcome(runs[0].job, Found("finished"), 10.0))
    sweep.ended(Outcome(runs[1].job, Found("finished"), 30.0))
    sweep.ended(Outcome(runs[2].job, Found("failed", "broken"), 1.0))
    sweep.started(runs[3].job)
    now = 145.0
    sweep.started(runs[4].job)
    now = 150.0
    assert sweep.seconds_left() == pytest.approx(37.5)
    assert sweep.summary_line() == ("ablation: 2 of 8 done, 2 running, 1 failed or stopped, 3 waiting; about 38 s left")


def test_plain_lines_where_there_is_no_terminal() -> None:
    file = io.StringIO()
    there, one, other = planned("there"), planned("one [row]"), planned("other")
    with SweepView(Console(file=file), "ablation", [there, one, other], at_once=1) as sweep:
        sweep.leave(there, Found("finished"))
        sweep.started(one.job)
        sweep.refresh()
        sweep.ended(Outcome(one.job, Found("finished"), 61.0))
        sweep.waits(other.job, "process 7")
        sweep.ended(Outcome(other.job, Found("finished"), 0.0))
    assert file.getvalue().splitlines() == [
        "[0/2] started: one [row], 03, seed 0",
        "[1/2] done in 1 min 01 s: one [row], 03, seed 0",
        "[1/2] running elsewhere (process 7): other, 03, seed 0",
        "[2/2] done elsewhere: other, 03, seed 0",
    ]


def test_a_live_table_by_cell(tmp_path: Path) -> None:
    """Two rows, two columns, two seeds; one run is made on another machine, and its folder says how far it is."""
    runs = [planned(row, seed, root=tmp_path) for row in ("full", "w/o ss") for seed in (0, 1)]
    runs += [replace(run, cell=Cell(run.cell.row, "06", ()), folder=run.folder / "06") for run in runs]
    file = io.StringIO()
    console = Console(file=file, force_terminal=True, width=100, height=40, color_system=None)
    with SweepView(console, "main_kitti", runs, at_once=0) as sweep:
        sweep.leave(runs[0], Found("finished"))
        sweep.leave(runs[1], Found("failed"))
        sweep.started(runs[2].job, "node7")
        sweep.waits(runs[3].job, "process 7")
        status = {"state": "running", "frames_done": 3, "frames_total": 12, "host": "node7", "stage": "mapping"}
        runs[2].folder.mkdir(parents=True)
        (runs[2].folder / "status.json").write_text(json.dumps(status))
        sweep._refreshed = -1.0
        sweep.refresh()
    lines = [line.rstrip() for line in file.getvalue().splitlines()]
    assert any(
        "main_kitti: 1 of 8 done, 1 running, 1 failed or stopped, 1 running elsewhere, 4 waiting" in line
        for line in lines
    )
    assert any(line.split() == ["03", "06"] for line in lines)
    assert any(line.split() == ["full", "✓✗", "··"] for line in lines)
    assert any(line.split() == ["w/o", "ss", "▶25%▷0%", "··"] for line in lines)
    assert "  0 s: frame 3/12, w/o ss, 03, seed 0 (node7)" in lines
    assert "  0 s: frame 0/4, w/o ss, 03, seed 1 (process 7)" in lines


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.4, "0 s"), (59.6, "1 min 00 s"), (3599, "59 min 59 s"), (7800, "2 h 10 min")]
)
def test_durations(seconds: float, words: str) -> None:
    assert duration(seconds) == words
