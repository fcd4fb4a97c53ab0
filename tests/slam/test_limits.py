"""What a machine runs out of: memory (by our own limit) and disk. The run says so, and nothing that it had is lost."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.cli import main
from bench.config import compose_run
from bench.runs.status import RunStatus, read_status, write_status
from bench.runs.watchdog import LimitsConfig, MemoryLimitError, TimeLimitError, Watchdog
from bench.slam.run import run_system
from plugins.mappers.gaussian import GaussianMapper
from plugins.stereo.sgbm import Sgbm
from tests.short_runs import FEW_ITERATIONS

TINY = ("dataset.frames=4", "dataset.width=320", "dataset.height=96", *FEW_ITERATIONS, "protocol.lpips=false")


def resident_gb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9


@pytest.mark.slow
def test_memory_limit_ends_the_run_in_good_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mapper takes 0.6 GB in its third keyframe, which is 0.3 GB too much; what was done until then is there."""
    hoard: list[Any] = []
    add = GaussianMapper.add_keyframe

    def greedy(self: GaussianMapper, keyframe: Any, window: Any) -> Any:
        if keyframe.frame.number == 2:
            hoard.append(np.ones(600_000_000, np.uint8))
            time.sleep(5.0)
            pytest.fail("nobody stopped it")
        return add(self, keyframe, window)

    monkeypatch.setattr(GaussianMapper, "add_keyframe", greedy)
    limit = resident_gb() + 0.3
    options = ["tracker=groundtruth", f"limits.memory_gb={limit}", f"output={tmp_path / 'run'}"]
    with pytest.raises(MemoryLimitError):
        run_system(compose_run([*TINY, *options]))
    hoard.clear()
    status = json.loads((tmp_path / "run" / "status.json").read_text())
    assert (status["state"], status["frames_done"]) == ("out_of_memory", 2)
    assert "more than limits.memory_gb=" in status["reason"]
    assert len((tmp_path / "run" / "trajectory_kitti.txt").read_text().splitlines()) == 2
    assert (tmp_path / "run" / "map.ply").is_file()
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("bgs-")]


def test_outside_the_main_thread_the_next_check_tells() -> None:
    raised: list[BaseException] = []

    def work() -> None:
        limit = Watchdog(LimitsConfig(memory_gb=0.001))
        with limit.watching():
            until = time.monotonic() + 10
            try:
                while time.monotonic() < until:
                    limit.check()
                    time.sleep(0.01)
            except MemoryLimitError as error:
                raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert len(raised) == 1


def test_a_peers_memory_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process of a plugin's own that has answered once; its 0.2 GB are above the limit, ours alone are not."""
    from bench import process_memory as memory

    code = "import sys; x = bytearray(200_000_000); print('ready', flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as peer:
        assert peer.stdout is not None
        peer.stdout.readline()
        memory.forget_peaks()
        assert memory.peers_now_gb() == 0
        memory.note_peak(peer.pid)
        assert 0.2 < memory.peers_now_gb() < 0.3
        with pytest.raises(MemoryLimitError), Watchdog(LimitsConfig(memory_gb=resident_gb() + 0.1)).watching():
            time.sleep(5.0)
    memory.forget_peaks()


def test_without_a_limit_nothing_watches() -> None:
    with Watchdog(LimitsConfig()).watching():
        assert not [thread.name for thread in threading.enumerate() if thread.name == "bgs-watchdog"]


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (LimitsConfig(hours=0.1 / 3600), "took longer than limits.hours"),
        (LimitsConfig(stall_minutes=0.1 / 60), "limits.stall_minutes"),
    ],
)
def test_a_limit_of_time_ends_what_hangs(limits: LimitsConfig, words: str) -> None:
    started = time.monotonic()
    with pytest.raises(TimeLimitError, match=words), Watchdog(limits).watching():
        time.sleep(10.0)
    assert time.monotonic() - started < 5.0


def test_steps_put_a_stall_off_but_not_the_hours() -> None:
    watchdog = Watchdog(LimitsConfig(stall_minutes=0.1 / 60))
    with watchdog.watching():
        for _ in range(10):
            time.sleep(0.03)
            watchdog.step()
    watchdog = Watchdog(LimitsConfig(hours=0.1 / 3600))
    time.sleep(0.2)
    with pytest.raises(TimeLimitError):
        watchdog.step()


@pytest.mark.slow
def test_a_stereo_network_that_never_returns_ends_the_run_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It hangs in the thread of the front end, where no signal comes; the frames before it are saved."""
    came_back = threading.Event()
    matched = Sgbm.matched

    def hanging(self: Sgbm, left: Any, right: Any) -> Any:
        if threading.current_thread().name == "bgs-front-end" and calls.append(0) is None and len(calls) == 2:
            came_back.wait(20.0)
        return matched(self, left, right)

    calls: list[int] = []
    monkeypatch.setattr(Sgbm, "matched", hanging)
    options = ["tracker=groundtruth", "limits.stall_minutes=0.05", "cache.enabled=false", f"output={tmp_path / 'run'}"]
    with pytest.raises(TimeLimitError):
        run_system(compose_run([*TINY, *options]))
    came_back.set()
    status = json.loads((tmp_path / "run" / "status.json").read_text())
    assert (status["state"], status["frames_done"]) == ("failed", 1)
    assert "nothing got done for 0.05 min" in status["reason"]
    assert len((tmp_path / "run" / "trajectory_kitti.txt").read_text().splitlines()) == 1
    assert "came_back.wait" in (tmp_path / "run" / "log.txt").read_text()


@pytest.mark.slow
def test_a_call_that_keeps_the_interpreter_is_ended_with_its_process(tmp_path: Path) -> None:
    """No thread of Python gets to run: the core's own ends the process, and writes what the status is left with."""
    code = f"""
import ctypes, pathlib
from bench.runs import watchdog
from bench.runs.status import RunStatus
watchdog.GRACE_S = 0.2
watched = watchdog.Watchdog(watchdog.LimitsConfig(stall_minutes=0.1 / 60))
with watched.watching():
    watched.begin(lambda reason: (pathlib.Path({str(tmp_path)!r}), RunStatus("failed", reason, frames_done=3)))
    ctypes.PyDLL(None).sleep(20)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=15)
    assert ended.returncode == 1
    assert ended.stderr.startswith("bgs-bench: nothing got done for ")
    status = read_status(tmp_path)
    assert status is not None
    assert (status.state, status.frames_done) == ("failed", 3)
    assert status.reason.endswith("and did not end within 0.2 s")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 660 kB; ``remount`` makes it larger."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=660k", "none", str(place)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a small file system is not allowed here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.mark.slow
def test_a_full_disk_fails_the_run_and_space_mends_it(small_disk: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The renders don't fit. The status is told all the same, and once there is space the same command gets through."""
    command = ["run", *TINY, "checkpoint_s=inf", f"output={small_disk / 'run'}"]
    assert main(command) != 0
    printed = capfd.readouterr()
    said = printed.err.strip().splitlines()[-1]
    assert said.startswith("bgs-bench: Can't write ")
    assert "No space left on device" in said
    assert "Traceback" not in printed.err + printed.out
    status = json.loads((small_disk / "run" / "status.json").read_text())
    assert status["state"] == "failed"
    assert "No space left on device" in status["reason"]
    subprocess.run(["mount", "-o", "remount,size=50m", str(small_disk)], check=True)
    assert main(command) == 0
    assert json.loads((small_disk / "run" / "status.json").read_text())["state"] == "done"


def test_a_status_is_written_where_not_one_block_is_left(small_disk: Path) -> None:
    write_status(small_disk, RunStatus("running", pid=1))
    with open(small_disk / "filler", "wb", buffering=0) as filler:
        try:
            while True:
                filler.write(bytes(1024))
        except OSError:
            pass
    lost = [[k, k] for k in range(0, 4000, 2)]
    write_status(small_disk, RunStatus("failed", "no space " * 1000, frames_done=7, lost_stretches=lost))
    status = read_status(small_disk)
    assert status is not None
    assert (status.state, status.frames_done) == ("failed", 7)
    assert status.reason.startswith("no space no space")
