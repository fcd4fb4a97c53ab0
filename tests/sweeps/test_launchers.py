"""The launchers with fakes in place of runs: the same table, GPUs, kills, Ctrl-C; and settings that can't be."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import fake_slurm
import pytest
from fake_bench import FULL, Bench, is_running, wait_until

from bench.cli import main
from bench.sweeps.launchers import choice as launchers
from bench.sweeps.launchers.config import compose_launcher

MakeBench = Callable[[str], Bench]
# One machine and its loopback are the network.
LOOPBACK = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
MODULES = {"joblib": "hydra_joblib_launcher", "slurm_local": "hydra_submitit_launcher", "ray": "hydra_ray_launcher"}


def needs(launcher: str) -> None:
    """Skip where the launcher's extra is not installed."""
    pytest.importorskip(f"hydra_plugins.{MODULES[launcher]}", reason=f"launcher={launcher} is not installed")


def needed(launcher: str) -> object:
    """A parameter that is skipped where the launcher's extra is not installed."""
    try:
        missing = importlib.util.find_spec(f"hydra_plugins.{MODULES[launcher]}") is None
    except ModuleNotFoundError:
        missing = True
    return pytest.param(launcher, marks=pytest.mark.skipif(missing, reason=f"launcher={launcher} is not installed"))


@pytest.fixture(scope="module")
def basic(tmp_path_factory: pytest.TempPathFactory, kitti: Path) -> Bench:
    """A sweep of one seed by the basic launcher."""
    bench = Bench(tmp_path_factory.mktemp("basic") / "bench", kitti)
    assert bench.reproduce("--seeds", "0") == 0
    return bench


@pytest.fixture(scope="module")
def two_nodes() -> Iterator[str]:
    """The address of a Ray cluster of two nodes."""
    needs("ray")
    script = str(Path(__file__).with_name("ray_cluster.py"))
    cluster = subprocess.Popen(
        [sys.executable, script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | LOOPBACK,
    )
    assert cluster.stdin is not None
    assert cluster.stdout is not None
    address = next((line.strip() for line in cluster.stdout if re.fullmatch(r"[\d.]+:\d+\n", line)), "")
    assert address, "the cluster did not start"
    yield address
    cluster.stdin.close()
    cluster.wait(timeout=60)


@pytest.mark.slow
@pytest.mark.parametrize("launcher", [needed("joblib"), needed("slurm_local")])
def test_the_same_table_and_a_gpu_for_each(
    make_bench: MakeBench, basic: Bench, monkeypatch: pytest.MonkeyPatch, launcher: str
) -> None:
    """Two slots, two GPUs: runs at the same time have different ones."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")
    bench = make_bench("bench")
    bench.behave(others="meet", seed0="slow")
    assert bench.reproduce("--seeds", "0", "--jobs", "2", f"launcher={launcher}") == 0
    assert len(bench.started()) == 3
    assert bench.tables() == basic.tables()
    used = check_gpus((bench.control / "gpus.txt").read_text())
    assert used == {"3", "5"}
    # Nothing of the launcher's own is left.
    assert {path.suffix for path in (bench.folder / "results/runs/.sweep").iterdir()} == {".lock", ".log"}


def check_gpus(noted: str) -> set[str]:
    """Assert that no GPU was given to two runs at a time; which were used."""
    busy: set[str] = set()
    used: set[str] = set()
    for what, gpu in (line.split() for line in noted.splitlines()):
        if what == "begins":
            assert gpu not in busy
            busy.add(gpu)
            used.add(gpu)
        else:
            busy.remove(gpu)
    return used


@pytest.mark.slow
def test_the_basic_launcher_deals_out_gpus(make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")
    bench = make_bench("bench")
    bench.behave(others="meet")
    assert bench.reproduce("--seeds", "0", "--jobs", "2", "launcher=basic") == 0
    assert check_gpus((bench.control / "gpus.txt").read_text()) == {"3", "5"}


@pytest.mark.slow
def test_two_nodes_of_a_ray_cluster(
    make_bench: MakeBench, basic: Bench, two_nodes: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are used, the table is the same, and a worker that is killed is replaced."""
    for name, value in LOOPBACK.items():
        monkeypatch.setenv(name, value)
    bench = make_bench("bench")
    bench.behave(others="meet", seed0="hang")
    sweep = bench.start("--seeds", "0", "launcher=ray", f"hydra.launcher.ray.init.address={two_nodes}")
    run = bench.hanging(seed=0)
    worker = parent_of(run)
    os.kill(worker, signal.SIGKILL)
    bench.behave()
    wait_until(lambda: not is_running(worker))
    os.kill(run, signal.SIGKILL)
    said, _ = sweep.communicate(timeout=120)
    assert sweep.returncode == 0, said
    started = bench.started()
    assert started.count(f"{FULL}0") == 2
    assert len(started) == 4
    assert len(set(re.findall(r"started \(.*, Ray node (\w+)\)", said))) == 2, said
    assert bench.tables() == basic.tables()


@pytest.mark.parametrize(("gpus", "asks"), [("gpu:a100:4", True), ("(null)", False)])
@pytest.mark.slow
def test_slurm_by_a_stand_in(
    make_bench: MakeBench, basic: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gpus: str, asks: bool
) -> None:
    """What is submitted, that it makes the same table, and that a GPU is asked for where the partition has some."""
    needs("slurm_local")
    fake_slurm.install(tmp_path / "slurm", gpus)
    monkeypatch.setenv("PATH", f"{tmp_path / 'slurm'}:{os.environ['PATH']}")
    bench = make_bench("bench")
    settings = ("hydra.launcher.partition=fast", "hydra.launcher.cpus_per_task=2")
    assert bench.reproduce("--seeds", "0", "launcher=slurm", *settings) == 0
    assert len(bench.started()) == 3
    assert bench.tables() == basic.tables()
    submitted = (tmp_path / "slurm" / "submitted").read_text().splitlines()
    wanted = {"--partition=fast", "--cpus-per-task=2", "--mem=16GB", "--time=720", "--array=0-2%3"}
    assert {f"#SBATCH {option}" for option in wanted} <= set(submitted)
    assert ("#SBATCH --gpus-per-node=1" in submitted) == asks
    assert (tmp_path / "slurm" / "asked").read_text() == "-h -o %G -p fast"


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


@pytest.mark.slow
@pytest.mark.parametrize("launcher", [needed("joblib"), needed("slurm_local")])
def test_a_killed_worker_ends_no_other_run_and_the_same_command_resumes(
    make_bench: MakeBench, basic: Bench, launcher: str
) -> None:
    """It hangs in the last row of the first seed, so that two runs are made before; joblib is to make three after."""
    bench = make_bench("bench")
    bench.behave(seed0="hang")
    command = ("--seeds", "0,1", "--jobs", "2", "launcher=joblib")
    if launcher == "slurm_local":
        command = ("--seeds", "0", "--jobs", "3", "launcher=slurm_local")
    sweep = bench.start(*command)
    run = bench.hanging(seed=0)
    worker = parent_of(run)
    os.kill(worker, signal.SIGKILL)
    wait_until(lambda: not is_running(worker))
    os.kill(run, signal.SIGKILL)
    said, _ = sweep.communicate(timeout=120)
    assert sweep.returncode == 1, said
    assert "Traceback" not in said
    assert f"interrupted: {FULL}0 (its worker died (" in said
    assert len(bench.started()) == (6 if launcher == "joblib" else 3)
    assert "three_rows.md" in bench.tables()

    bench.behave()
    assert bench.reproduce(*command) == 0
    assert bench.started() == [f"{FULL}0"]
    if launcher == "joblib":
        assert bench.reproduce("--seeds", "0") == 0
    assert bench.tables() == basic.tables()


@pytest.mark.slow
def test_a_killed_sweep_leaves_its_run_but_no_launcher(make_bench: MakeBench) -> None:
    needs("joblib")
    bench = make_bench("bench")
    bench.behave(seed0="hang")
    command = ("--seeds", "0,1", "launcher=joblib")
    sweep = bench.start(*command)
    run = bench.hanging(seed=0)
    launcher = parent_of(parent_of(run))
    sweep.kill()
    wait_until(lambda: not is_running(launcher))
    assert is_running(run)
    os.kill(run, signal.SIGKILL)
    assert len(bench.started()) == 3
    bench.behave()
    assert bench.reproduce(*command) == 0
    assert len(bench.started()) == 4


@pytest.mark.slow
@pytest.mark.parametrize("launcher", [needed("joblib"), needed("slurm_local")])
def test_ctrl_c_reaches_the_workers(make_bench: MakeBench, launcher: str) -> None:
    bench = make_bench("bench")
    bench.behave(seed0="polite")
    more = ("--seeds", "0,1" if launcher == "joblib" else "0")
    sweep = bench.start(*more, f"launcher={launcher}")
    run = bench.hanging(seed=0)
    sweep.send_signal(signal.SIGINT)
    said, _ = sweep.communicate(timeout=60)
    assert sweep.returncode == 130, said
    assert not is_running(run)
    assert f"interrupted: {FULL}0 (stopped by the user)" in said
    assert len(bench.started()) == 3


@pytest.mark.slow
def test_a_run_that_the_kernel_killed_for_want_of_memory(
    make_bench: MakeBench, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from bench.sweeps import oom_kills

    bench = make_bench("bench")
    (bench.control / "vmstat").write_text("pgfault 12\noom_kill 7\n")
    monkeypatch.setattr(oom_kills, "_VMSTAT", bench.control / "vmstat")
    monkeypatch.setattr(oom_kills, "_OWN_CGROUP", bench.control / "none")
    bench.behave(seed0="oom-kill")
    assert bench.reproduce("--seeds", "0") == 1
    words = "out of memory: the system ended it for want of memory"
    assert f"failed: {FULL}0 ({words})" in capfd.readouterr().out
    assert "out of memory" in bench.tables()["three_rows.md"].decode()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["launcher=rai"], "launcher='rai' is not one of basic, joblib, slurm, slurm_local, ray. Did you mean 'ray'?"),
        (["launcher=ray,slurm"], "launcher=ray,slurm: a sweep has one launcher of"),
        (["hydra.launcher.n_jobs=3"], "hydra.launcher.n_jobs=3: launcher=basic has no settings; it has --jobs N."),
        (["launcher=joblib", "hydra.launcher.njobs=3"], "Did you mean 'n_jobs'?"),
        (["launcher=slurm", "hydra.launcher.partitn=gpu"], "Did you mean 'partition'?"),
        (["launcher=slurm", "hydra.launcher.timeout_min=soon"], "hydra.launcher.timeout_min=soon: Value 'soon'"),
        (["launcher=joblib", "hydra.launcher.n_jobs=2,3"], "hydra.launcher.n_jobs=2,3 names several values"),
        (["launcher=ray", "--jobs", "2"], "--jobs 2 is for one machine; how many runs launcher=ray makes at once"),
    ],
)
def test_launchers_that_cannot_be(arguments: list[str], message: str, capfd: pytest.CaptureFixture[str]) -> None:
    for launcher in MODULES:
        needs(launcher)
    assert main(["run", "-m", "seed=0,1", *arguments]) == 2
    error = capfd.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert main(["reproduce", "ablation", *arguments]) == 2


def test_a_launcher_that_is_not_installed(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(launchers.importlib.util, "find_spec", lambda module: None)
    assert main(["run", "-m", "seed=0,1", "launcher=slurm_local"]) == 2
    words = "launcher=slurm_local is not installed: pip install 'bgs-slam-bench[slurm]'"
    assert capfd.readouterr().err == f"bgs-bench: {words}\n"


def test_launchers_are_for_sweeps(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "launcher=joblib"]) == 2
    assert capfd.readouterr().err == "bgs-bench: launcher=, sweeper= and --jobs are for many runs; add -m.\n"


def test_presets_and_their_settings() -> None:
    for launcher in MODULES:
        needs(launcher)
    cores = len(os.sched_getaffinity(0))
    assert compose_launcher("joblib", [], 3).at_once == 3
    assert compose_launcher("joblib", ["hydra.launcher.n_jobs=4"], 1).at_once == 4
    assert compose_launcher("joblib", ["hydra.launcher.n_jobs=-1"], 1).at_once == cores
    slurm = compose_launcher("slurm", ["hydra.launcher.partition=gpu", "hydra.launcher.mem_gb=8"], 0)
    assert (slurm.settings.partition, slurm.settings.mem_gb, slurm.at_once) == ("gpu", 8, 0)
    ray = compose_launcher("ray", ["hydra.launcher.ray.init.address=10.0.0.1:6379"], 0)
    assert (ray.settings.ray.init.address, ray.settings.ray.init.include_dashboard) == ("10.0.0.1:6379", False)
