"""Spoilt files of every kind: each is read, or refused in one line; nothing hangs, and nothing is touched elsewhere.

``BGS_FUZZ=1000 python -m pytest tests/fuzzing`` (``make fuzz``) tries so many; ``BGS_FUZZ_SEED`` chooses others.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.cache.entry import DamagedEntryError
from bench.errors import BenchError
from bench.plain_text import MOST, plain_line
from tests.fuzzing.mutations import mutate
from tests.fuzzing.targets import TARGETS, Target

COUNT = int(os.environ.get("BGS_FUZZ", "100"))
SEED = int(os.environ.get("BGS_FUZZ_SEED", "0"))
LIMIT_S = 20
"""For one file, all commands that read it; the slowest takes a second."""
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_CHANGES = {f"os.{name}" for name in ("remove", "rename", "mkdir", "rmdir", "link", "symlink", "truncate")}
_STARTS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "socket.connect")


class Watch:
    """Sees, through Python's audit events, what is written, removed or started; the hook itself can't be taken away."""

    def __init__(self) -> None:
        self.folder: Path | None = None
        self.seen: list[str] = []
        sys.addaudithook(self._hook)

    @contextmanager
    def only_in(self, folder: Path) -> Iterator[None]:
        """Collect what happens outside of ``folder`` in the block."""
        self.folder, self.seen = folder, []
        try:
            yield
        finally:
            self.folder = None

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.folder is None:
            return
        if event in _STARTS:
            self.seen.append(f"{event} {arguments[:2]}")
        elif event == "open":
            if isinstance(arguments[2], int) and arguments[2] & _WRITES:
                self._changed(event, arguments[0])
        elif event in _CHANGES:
            for place in arguments[:2]:
                self._changed(event, place)

    def _changed(self, event: str, place: Any) -> None:
        if not isinstance(place, (str, bytes, os.PathLike)):
            return
        path = os.path.abspath(os.fsdecode(place))
        if not path.startswith((f"{self.folder}{os.sep}", "/dev/null")) and "__pycache__" not in path:
            self.seen.append(f"{event} {path}")


@pytest.fixture(scope="module")
def watch() -> Watch:
    return Watch()


@contextmanager
def limited() -> Iterator[None]:
    def end(signum: int, frame: Any) -> None:
        raise TimeoutError(f"not done after {LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for each target, with its whole files."""
    top = tmp_path_factory.mktemp("whole")
    for number, target in enumerate(TARGETS):
        (top / str(number) / target.file).parent.mkdir(parents=True)
        if target.file.startswith("run/"):
            shutil.rmtree(top / str(number) / "run")
        target.make(top / str(number))
    return top


@pytest.mark.parametrize("number", range(len(TARGETS)))
def test_spoilt_files_are_read_or_refused_in_one_line(
    number: int,
    whole: Path,
    tmp_path: Path,
    watch: Watch,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("bench.report.trajectory_plot.write_trajectory_plot", lambda *_: None)
    monkeypatch.chdir(tmp_path)
    target = TARGETS[number]
    target.read(shutil.copytree(whole / str(number), tmp_path / "as it was"))
    capfd.readouterr()
    content = (whole / str(number) / target.file).read_bytes()
    faults = []
    for attempt in range(-(-COUNT // len(TARGETS))):
        spoilt, how = mutate(content, np.random.default_rng([SEED, number, attempt]))
        place = shutil.copytree(whole / str(number), tmp_path / str(attempt))
        (place / target.file).write_bytes(spoilt)
        with watch.only_in(tmp_path):
            fault = _fault(target, place, capfd)
        fault = fault or "; ".join(watch.seen)
        if fault:
            faults.append(f"{target.file}, attempt {attempt} ({how}): {fault}")
        shutil.rmtree(place)
    assert not faults, "\n".join(faults)


def _fault(target: Target, place: Path, capfd: pytest.CaptureFixture[str]) -> str:
    """What a reader did that it should not, or an empty string."""
    message = ""
    try:
        with limited():
            target.read(place)
    except DamagedEntryError:
        message = ""
    except BenchError as error:
        message = plain_line(str(error))
    except BaseException as error:  # a reader may raise anything, which is what is looked for
        if isinstance(error, KeyboardInterrupt):
            raise
        return f"{type(error).__name__}: {str(error)[:300]} {_where(error)}"
    said = capfd.readouterr()
    lines = [message, *said.err.splitlines()]
    if "Traceback" in said.err or "Traceback" in said.out:
        return f"a traceback: {said.err[-500:]}"
    if any(len(line) > MOST + 100 for line in lines):
        return f"a message of {max(map(len, lines))} characters"
    if any((sign < " " and sign not in "\n\t") or sign in "\x7f\u202e" for sign in said.err + said.out):
        return f"a control character on the terminal: {(said.err + said.out)[-300:]!r}"
    return ""


def _where(error: BaseException) -> str:
    trace = error.__traceback__
    places = []
    while trace is not None:
        places.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
        trace = trace.tb_next
    return " < ".join(reversed(places[-5:]))
