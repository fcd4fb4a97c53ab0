"""The share of a job, the claim between processes, and what an end means."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bench.errors import BenchError
from bench.io.file_lock import has_locks
from bench.sweeps import child, oom_kills
from bench.sweeps.child import environment_of
from bench.sweeps.claim import Claim, claimed_by, is_claimed
from bench.sweeps.job import Job, Outcome
from bench.sweeps.launchers import launched
from bench.sweeps.launchers.choice import LauncherChoice
from bench.sweeps.launchers.exchange import Note
from bench.sweeps.launchers.gpus import gpus_of_this_machine
from bench.sweeps.launchers.launch import Order
from bench.sweeps.launchers.slots import Slots
from bench.sweeps.lookup import Found
from bench.sweeps.sweep import Choice, Sweep


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
    assert is_claimed(run_folder)
    assert claimed_by(run_folder) == f"process {os.getpid()}"
    heir = subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE, pass_fds=[claim.fd])
    claim.note(heir.pid)
    claim.release()
    assert Claim.attempt(run_folder) is None
    assert claimed_by(run_folder) == f"process {heir.pid}"
    heir.kill()
    heir.wait()
    assert not is_claimed(run_folder)
    again = Claim.attempt(run_folder)
    assert again is not None
    again.release()


VMSTAT = "nr_free_pages 12\noom_kill {}\npgfault 8\n"


def test_the_kernels_count_of_what_it_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cgroup's own count, where the process is in one that has it, else the machine's."""
    monkeypatch.setattr(oom_kills, "_VMSTAT", tmp_path / "vmstat")
    monkeypatch.setattr(oom_kills, "_OWN_CGROUP", tmp_path / "cgroup")
    monkeypatch.setattr(oom_kills, "_CGROUPS", tmp_path / "sys")
    assert oom_kills.oom_kills() is None
    (tmp_path / "vmstat").write_text(VMSTAT.format(7))
    assert oom_kills.oom_kills() == 7
    (tmp_path / "cgroup").write_text("3:cpu:/other\n0::/jobs/one\n")
    assert oom_kills.oom_kills() == 7
    events = tmp_path / "sys/jobs/one/memory.events"
    events.parent.mkdir(parents=True)
    events.write_text("low 0\nmax 9\noom 2\noom_kill 1\n")
    assert oom_kills.oom_kills() == 1


def test_this_machine_counts() -> None:
    line = next((line for line in Path("/proc/vmstat").read_text().splitlines() if line.startswith("oom_kill ")), None)
    if line is None:
        pytest.skip("this kernel keeps no count")
    assert oom_kills.oom_kills() is not None


def test_slots_of_a_machine(tmp_path: Path) -> None:
    """Two slots for three workers; the third waits, and a process that inherits a slot keeps it."""
    slots = Slots(tmp_path, 2, ("0", "1"))

    class WaitsError(Exception):
        pass

    def give_up() -> None:
        raise WaitsError

    with slots.one(give_up) as (first, _):
        with slots.one(give_up) as (second, file):
            assert {first, second} == {0, 1}
            with pytest.raises(WaitsError), slots.one(give_up):
                pass
            heir = subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE, pass_fds=[file])
        with pytest.raises(WaitsError), slots.one(give_up):
            pass
        heir.kill()
        heir.wait()
        with slots.one(give_up) as (again, _):
            assert again == second


def test_a_run_that_can_not_be_claimed_fails_alone(tmp_path: Path) -> None:
    """Where its lock file would be there is something else; the other run is made."""
    told: list[tuple[str, str]] = []

    class Listener:
        def started(self, job: Job, place: str = "") -> None: ...
        def waits(self, job: Job, who: str) -> None: ...
        def refresh(self) -> None: ...
        def ended(self, outcome: Outcome) -> None:
            told.append((outcome.job.label, f"{outcome.found.progress}: {outcome.found.reason}"))

    (tmp_path / ".sweep" / "bad.lock").mkdir(parents=True)
    jobs = [
        Job(name, tmp_path / name, tmp_path, ("-S", "-c", "raise SystemExit('no weights')")) for name in ("bad", "good")
    ]
    Sweep(jobs, 1, Choice(), Listener(), lambda slot: dict(os.environ)).run()
    assert told == [
        (
            "bad",
            f"failed: Can't make {tmp_path}/.sweep/bad.lock: Is a directory. "
            "Give output= a place that you may write to.",
        ),
        ("good", "failed: no weights"),
    ]


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Every claim is granted, and whoever sweeps is told."""
    assert has_locks(tmp_path)

    def refuse(file: int, what: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert not has_locks(tmp_path)
    claims = [Claim.attempt(tmp_path / "run") for _ in range(2)]
    assert not is_claimed(tmp_path / "run")
    for claim in claims:
        assert claim is not None
        claim.release()


@pytest.mark.parametrize("scored", [False, True])
def test_a_process_that_ends_without_an_error_before_its_run_is_done(tmp_path: Path, scored: bool) -> None:
    """A plugin's ``os._exit(0)``: while mapping, or while scoring."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.yaml").write_text("# bgs-bench run, config hash 0\nseed: 0\n")
    state = "done" if scored else "running"
    code = (
        "import json, os, pathlib, socket\n"
        f"status = {{'state': {state!r}, 'pid': os.getpid(), 'host': socket.gethostname()}}\n"
        f"pathlib.Path({str(folder / 'status.json')!r}).write_text(json.dumps(status))\n"
        "os._exit(0)\n"
    )
    claim = Claim.attempt(folder)
    assert claim is not None
    found = child.Child(Job("run", folder, tmp_path, ("-S", "-c", code)), claim, dict(os.environ)).outcome().found
    assert found.progress == "failed"
    assert found.reason.startswith("its process ended with exit code 0 before the run was done")


@pytest.mark.parametrize("sent", [signal.SIGABRT, signal.SIGTERM])
def test_a_full_disk_hides_no_crash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sent: signal.Signals) -> None:
    """The run's status can't be completed: the outcome says both how it ended and that."""

    def full(folder: Path, status: object) -> None:
        raise BenchError("No space left on device")

    monkeypatch.setattr(child, "write_status", full)
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.yaml").write_text("# bgs-bench run, config hash 0\nseed: 0\n")
    code = (
        "import json, os, pathlib, socket\n"
        "status = {'state': 'running', 'pid': os.getpid(), 'host': socket.gethostname()}\n"
        f"pathlib.Path({str(folder / 'status.json')!r}).write_text(json.dumps(status))\n"
        f"os.kill(os.getpid(), {int(sent)})\n"
    )
    claim = Claim.attempt(folder)
    assert claim is not None
    found = child.Child(Job("run", folder, tmp_path, ("-S", "-c", code)), claim, dict(os.environ)).outcome().found
    assert found.progress == ("failed" if sent == signal.SIGABRT else "interrupted")
    assert found.reason.startswith(f"ended by signal {int(sent)} (")
    assert "No space left on device" in found.reason


def test_a_run_takes_no_module_from_the_current_folder(tmp_path: Path) -> None:
    (tmp_path / "json.py").write_text("open('proof', 'w').close()\n")
    folder = tmp_path / "run"
    claim = Claim.attempt(folder)
    assert claim is not None
    child.Child(Job("run", folder, tmp_path, ("-S", "-c", "import json")), claim, dict(os.environ)).outcome()
    assert not (tmp_path / "proof").exists()


def test_a_run_that_a_dying_launcher_had_only_just_taken_is_launched_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A launcher that loses one worker may end the others: of three runs one is done, one cut, one has nothing yet."""
    jobs = [Job(name, tmp_path / name, tmp_path, ()) for name in ("done", "cut", "taken")]
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "config.yaml").touch()
    launches: list[list[str]] = []

    class Launch:
        def __init__(self, order: Order) -> None:
            launches.append([job.label for job in order.task.jobs])
            for number, job in enumerate(order.task.jobs):
                done = job.label == "done" or len(launches) == 2
                note = Note("ended", found=Found("finished")) if done else Note("begun")
                order.task.exchange.write(number, note)

        def has_ended(self) -> bool:
            return True

        def succeeded(self) -> bool:
            return len(launches) == 2

        def last_words(self) -> str:
            return "one was killed"

    ended: dict[str, Found] = {}

    class Listener:
        def started(self, job: Job, place: str = "") -> None: ...
        def waits(self, job: Job, who: str) -> None: ...
        def refresh(self) -> None: ...
        def ended(self, outcome: Outcome) -> None:
            assert outcome.job.label not in ended
            ended[outcome.job.label] = outcome.found

    monkeypatch.setattr(launched, "_Launch", Launch)
    monkeypatch.setattr(launched, "_POLL_S", 0.01)
    monkeypatch.setattr(launched, "_QUIET_S", 0.0)
    launched.LaunchedSweep(jobs, LauncherChoice("joblib"), Choice(), Listener(), tmp_path).run()
    assert launches == [["done", "cut", "taken"], ["taken"]]
    cut = Found("interrupted", "its worker died (one was killed)")
    assert ended == {"done": Found("finished"), "cut": cut, "taken": Found("finished")}
