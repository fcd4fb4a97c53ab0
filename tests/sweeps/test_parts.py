"""The share of a job, the claim between processes, and the time left."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from bench.config import RunConfig
from bench.sweeps import view
from bench.sweeps.child import Outcome, environment_of
from bench.sweeps.claim import Claim, claimed_by
from bench.sweeps.gpus import gpus_of_this_machine
from bench.sweeps.lookup import Found
from bench.sweeps.plan import PlannedRun
from bench.sweeps.view import SweepView, duration
from bench.tables.named.definitions import Cell


def planned(row: str) -> PlannedRun:
    return PlannedRun(Cell(row, "03", ()), 0, RunConfig({}, row), Path(row), (), 4)


def test_gpus_are_dealt_out_in_turn() -> None:
    gpus = ["0", "2", "GPU-abc"]
    dealt = [environment_of(slot, 5, gpus)["CUDA_VISIBLE_DEVICES"] for slot in range(5)]
    assert dealt == ["0", "2", "GPU-abc", "0", "2"]


def test_without_gpus_the_variable_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert "CUDA_VISIBLE_DEVICES" not in environment_of(0, 2, [])


def test_gpus_that_the_user_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3, 5")
    assert gpus_of_this_machine() == ["3", "5"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert gpus_of_this_machine() == []


def test_the_cores_are_shared_by_the_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(12)))
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert environment_of(0, 5, [])["OMP_NUM_THREADS"] == "2"
    assert environment_of(0, 30, [])["OMP_NUM_THREADS"] == "1"
    assert "OMP_NUM_THREADS" not in environment_of(0, 1, [])


def test_a_claim_lasts_as_long_as_any_process_that_has_it(tmp_path: Path) -> None:
    """Released here, it is still held by the process that inherited it, until that one ends."""
    run_folder = tmp_path / "run"
    claim = Claim.attempt(run_folder)
    assert claim is not None
    assert Claim.attempt(run_folder) is None
    assert claimed_by(run_folder) == f"process {os.getpid()}"
    heir = subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE, pass_fds=[claim.fd])
    claim.note(heir.pid)
    claim.release()
    assert Claim.attempt(run_folder) is None
    assert claimed_by(run_folder) == f"process {heir.pid}"
    heir.kill()
    heir.wait()
    again = Claim.attempt(run_folder)
    assert again is not None
    again.release()


def test_time_left_by_the_mean_of_the_finished_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of 10 and 30 s make 20 s a run. One of eight has run for 5 s, one for 50 s, one failed, three wait:
    (15 + 0 + 3 * 20) / 2 = 37.5 s."""
    now = 100.0
    monkeypatch.setattr(view.time, "monotonic", lambda: now)
    sweep = SweepView(Console(file=io.StringIO()), "ablation", total=8, jobs=2)
    assert sweep.seconds_left() is None
    sweep.ended(Outcome(planned("a"), Found("finished"), 10.0))
    sweep.ended(Outcome(planned("b"), Found("finished"), 30.0))
    sweep.ended(Outcome(planned("c"), Found("failed", "broken"), 1.0))
    sweep.started(planned("d"))
    now = 145.0
    sweep.started(planned("e"))
    now = 150.0
    assert sweep.seconds_left() == pytest.approx(37.5)
    assert sweep.summary_line() == "ablation: 2 of 8 done, 2 running, 1 failed or stopped; about 38 s left"


def test_plain_lines_where_there_is_no_terminal() -> None:
    file = io.StringIO()
    with SweepView(Console(file=file), "ablation", total=2, jobs=1) as sweep:
        sweep.started(planned("one [row]"))
        sweep.refresh()
        sweep.ended(Outcome(planned("one [row]"), Found("finished"), 61.0))
        sweep.waits(planned("other"), "process 7")
        sweep.ended(Outcome(planned("other"), Found("finished"), 0.0))
    assert file.getvalue().splitlines() == [
        "[0/2] started: one [row], 03, seed 0",
        "[1/2] done in 1 min 01 s: one [row], 03, seed 0",
        "[1/2] running elsewhere (process 7): other, 03, seed 0",
        "[2/2] done elsewhere: other, 03, seed 0",
    ]


def test_a_live_summary_in_a_terminal() -> None:
    file = io.StringIO()
    with SweepView(Console(file=file, force_terminal=True, width=100), "ablation", total=2, jobs=1) as sweep:
        sweep.started(planned("one"))
        sweep.waits(planned("other"), "process 7")
        sweep._refreshed = -1.0
        sweep.refresh()
    text = file.getvalue()
    assert "0 of 2 done, 1 running, 1 running elsewhere" in text
    assert "running 0 s: one, 03, seed 0" in text
    assert "waiting for process 7: other, 03, seed 0" in text


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.4, "0 s"), (59.6, "1 min 00 s"), (3599, "59 min 59 s"), (7800, "2 h 10 min")]
)
def test_durations(seconds: float, words: str) -> None:
    assert duration(seconds) == words
