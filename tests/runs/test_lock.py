"""Two processes that start the same run do the work once."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from bench.errors import BenchError
from bench.runs.lock import LOCK_FILE, only_one
from tests.short_runs import FEW_ITERATIONS

TINY = ("dataset.frames=4", "dataset.width=160", "dataset.height=64", *FEW_ITERATIONS, "protocol.lpips=false")
TINY += ("tracker=groundtruth",)


@pytest.mark.slow
def test_two_processes_make_a_run_once(tmp_path: Path) -> None:
    """The second one waits, and then shows the row of the first one's run."""
    command = [sys.executable, "-m", "bench.cli", "run", *TINY, f"output={tmp_path / 'run'}"]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    log = (tmp_path / "run" / "log.txt").read_text()
    assert log.count("frame 0: keyframe") == 1
    waited = [text for text in said if "makes this run already" in text]
    assert len(waited) == 1, said
    other = both[1 - said.index(waited[0])].pid
    assert f"process {other} makes this run already" in waited[0]
    assert all(f"run folder: {tmp_path / 'run'}" in text for text in said)


def test_wrong_input_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="wrong"), only_one(tmp_path / "a" / "b" / "run", print):
        raise BenchError("wrong")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_in_a_folder_of_something_else(tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").touch()
    with pytest.raises(BenchError, match="wrong"), only_one(tmp_path, print):
        raise BenchError("wrong")
    assert [entry.name for entry in tmp_path.iterdir()] == ["photo.jpg"]


def test_a_folder_deleted_meanwhile_hides_no_error(tmp_path: Path) -> None:
    def fails() -> None:
        shutil.rmtree(tmp_path / "run")
        raise BenchError("the real one")

    with pytest.raises(BenchError, match="the real one"), only_one(tmp_path / "run", print):
        fails()


def test_what_was_there_stays(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").write_text("")
    with only_one(tmp_path / "run", print):
        pass
    assert (tmp_path / "run" / "config.yaml").is_file()


def test_one_after_the_other(tmp_path: Path) -> None:
    """Also when the first one removes the folder that it made, just when the second one gets the lock."""
    folder, entered, order = tmp_path / "run", threading.Event(), []

    def second() -> None:
        with only_one(folder, lambda who: entered.set()):
            order.append("second")
            (folder / "config.yaml").touch()

    with only_one(folder, print):
        thread = threading.Thread(target=second)
        thread.start()
        assert entered.wait(10)
        order.append("first")
    thread.join(10)
    assert order == ["first", "second"]
    assert (folder / "config.yaml").is_file()
    with open(folder / LOCK_FILE, "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody holds it any more


def test_a_file_in_its_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BenchError, match="is a file"), only_one(tmp_path / "file", print):
        pytest.fail("there is no folder")


def test_a_folder_that_cant_be_made_is_named(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        place = Path("/proc/nowhere")  # root may write everywhere else
    else:
        place = tmp_path / "closed" / "run"
        place.parent.mkdir(mode=0o500)
    with pytest.raises(BenchError, match="Can't make the run folder"), only_one(place, print):
        pytest.fail("there is no folder")
