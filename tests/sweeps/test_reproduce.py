"""``bgs-bench reproduce`` with fakes in place of runs: what is made, what is left, and what a kill does."""

from __future__ import annotations

import csv
import errno
import fcntl
import io
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from fake_bench import FULL, ROWS, Bench, is_running, wait_until

from bench.cli import main

MakeBench = Callable[[str], Bench]


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory, kitti: Path) -> Bench:
    """A sweep of three seeds that nothing disturbed."""
    bench = Bench(tmp_path_factory.mktemp("unbroken") / "bench", kitti)
    assert bench.reproduce() == 0
    return bench


def test_the_table_of_an_unbroken_sweep(unbroken: Bench) -> None:
    """The fakes' PSNR is 20 dB + the seed, so that each of the three rows has the mean 21 and the spread 1."""
    tables = unbroken.tables()
    assert set(tables) == {f"three_rows.{form}" for form in ("md", "csv", "tex", "html", "runs.json")}
    rows = list(csv.DictReader(io.StringIO(tables["three_rows.csv"].decode())))
    psnr = [row for row in rows if row["by"] == "ours" and row["metric"] == "psnr_db"]
    assert [(float(row["value"]), float(row["std"]), row["n"]) for row in psnr] == [(21.0, 1.0, "3")] * 3
    started = unbroken.started()
    assert len(started) == len(set(started)) == 9
    assert [label[-1] for label in started] == ["0"] * 3 + ["1"] * 3 + ["2"] * 3


@pytest.mark.slow
def test_the_row_of_a_users_backbone_alone_is_made_and_shown_beside_the_others(
    make_bench: MakeBench, capfd: pytest.CaptureFixture[str]
) -> None:
    """`new-plugin`, then `reproduce backbones stereo=NAME`; the row of the second backbone leaves that of the first."""
    bench = make_bench("backbones")
    bench.arguments = ["reproduce", "backbones", bench.arguments[-1]]
    for name in ("made_net", "next_net"):
        assert main(["new-plugin", "stereo", name, "--folder", str(bench.folder / "mine")]) == 0
        assert bench.reproduce(f"stereo={name}", "plugins=[mine]", "--seeds", "0,1") == 0
        assert bench.started() == [f"{name}, 03, seed 0", f"{name}, 03, seed 1"]
    rows = list(csv.DictReader(io.StringIO(bench.tables()["backbones.csv"].decode())))
    own = {row["method"]: row["value"] for row in rows if row["by"] == "ours" and row["metric"] == "psnr_db"}
    # The fakes' PSNR is 20 dB + the seed.
    assert [own["made_net"], own["next_net"], own["SGBM"]] == ["20.5", "20.5", ""]
    assert "backbones: 2 runs, 2 to make" in capfd.readouterr().out


@pytest.mark.slow
def test_what_is_there_is_not_made_again(unbroken: Bench, capfd: pytest.CaptureFixture[str]) -> None:
    before = unbroken.tables()
    unbroken.started()
    assert unbroken.reproduce() == 0
    assert unbroken.started() == []
    assert unbroken.tables() == before
    assert "9 runs, 0 to make" in capfd.readouterr().out


@pytest.mark.slow
def test_without_locks_one_run_is_made_at_a_time(
    make_bench: MakeBench, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(file: int, what: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    bench = make_bench("without-locks")
    bench.behave(others="slow")
    assert bench.reproduce("--seeds", "0", "--jobs", "3") == 0
    order = [line.split()[0] for line in (bench.control / "gpus.txt").read_text().splitlines()]
    assert order == ["begins", "ends"] * 3
    assert "a file system without locks: one run at a time" in capfd.readouterr().out


@pytest.mark.slow
def test_failures_end_nothing_else_and_are_chosen_by_kind(
    make_bench: MakeBench, capfd: pytest.CaptureFixture[str]
) -> None:
    bench = make_bench("failures")
    seeds = ("--seeds", "0,1,2,3")
    bench.behave(seed0="segv", seed1="oom", seed2="kill", seed3="wrong")
    assert bench.reproduce(*seeds, "--jobs", "2") == 1
    assert len(bench.started()) == 12
    out = capfd.readouterr().out
    assert f"failed: {FULL}0 (ended by signal 11 (Segmentation fault))" in out
    assert f"failed: {FULL}1 (out of memory: 40 GB wanted)" in out
    assert f"interrupted: {FULL}2 (ended by signal 9 (Killed))" in out
    assert f"failed: {FULL}3 (the weights are missing)" in out
    table = bench.tables()["three_rows.md"].decode()
    assert "seed 0: failed (ended by signal 11" in table
    assert "seed 2: killed (ended by signal 9" in table

    bench.reproduce(*seeds, "--dry-run")
    assert bench.started() == []
    plan = capfd.readouterr().out.splitlines()
    kinds = ("keep failed", "keep failed", "run  interrupted", "run  missing")
    assert [next(line for line in plan if f"{FULL}{seed}," in line).startswith(kinds[seed]) for seed in range(4)] == [
        True
    ] * 4

    bench.behave()
    assert bench.reproduce(*seeds, "--missing") == 1
    assert bench.started() == [f"{FULL}3"]
    assert bench.reproduce(*seeds) == 1
    assert bench.started() == [f"{FULL}2"]
    assert bench.reproduce(*seeds, "--rerun-failed") == 0
    assert bench.started() == [f"{FULL}0", f"{FULL}1"]


@pytest.mark.slow
def test_a_killed_sweep_is_resumed_to_the_same_table(
    make_bench: MakeBench, unbroken: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    """First a run is killed with SIGKILL, then the sweep itself; the run that it leaves behind is not made twice."""
    bench = make_bench("bench")
    bench.behave(seed0="hang", seed1="hang")
    sweep = bench.start()
    os.kill(bench.hanging(seed=0), signal.SIGKILL)
    orphan = bench.hanging(seed=1)
    sweep.kill()
    said, _ = sweep.communicate(timeout=60)
    assert f"interrupted: {FULL}0 (ended by signal 9" in said
    assert "Traceback" not in said
    assert is_running(orphan)
    assert not (bench.folder / "results" / "tables").exists()

    bench.started()
    bench.behave()
    going_on = bench.start()
    # All but the orphan's run can be made meanwhile: the killed one, and the third seed.
    made = [f"{FULL}0", *[f"{row}, 03, seed 2" for row in ROWS]]
    started = bench.control / "started.txt"
    wait_until(lambda: started.exists() and len(started.read_text().splitlines()) == len(made))
    assert bench.started() == made
    assert going_on.poll() is None
    os.kill(orphan, signal.SIGKILL)
    said, _ = going_on.communicate(timeout=60)
    assert going_on.returncode == 0, said
    assert f"running elsewhere (process {orphan}): {FULL}1" in said
    assert bench.started() == [f"{FULL}1"]
    assert bench.tables() == unbroken.tables()


@pytest.mark.slow
def test_two_sweeps_do_the_work_once(make_bench: MakeBench, unbroken: Bench) -> None:
    bench = make_bench("bench")
    bench.behave(seed0="slow", seed1="slow", seed2="slow")
    other = bench.start()
    assert bench.reproduce() == 0
    said, _ = other.communicate(timeout=120)
    assert other.returncode == 0, said
    started = bench.started()
    assert len(started) == len(set(started)) == 9
    assert bench.tables() == unbroken.tables()


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_the_runs_politely(make_bench: MakeBench, sent: signal.Signals) -> None:
    bench = make_bench("bench")
    bench.behave(seed0="polite")
    sweep = bench.start("--seeds", "0")
    pid = bench.hanging(seed=0)
    sweep.send_signal(sent)
    said, _ = sweep.communicate(timeout=60)
    assert sweep.returncode == 130
    assert not is_running(pid)
    assert f"interrupted: {FULL}0 (stopped by the user)" in said
    assert said.endswith("stopped; 2 finished, 1 interrupted. The same command resumes from there.\n")
    bench.started()
    bench.behave()
    assert bench.reproduce("--seeds", "0") == 0
    assert bench.started() == [f"{FULL}0"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", "0,0"], "must hold different numbers"),
        (["--seeds", "a"], "no list of whole numbers"),
        (["--jobs", "0"], "no whole number of at least 1"),
    ],
)
def test_wrong_options(
    make_bench: MakeBench, capfd: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    with pytest.raises(SystemExit, match="2"):
        make_bench("bench").reproduce(*arguments)
    assert message in capfd.readouterr().err
