"""A bench folder whose sweeps have fakes in place of runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from reproduce_with_fakes import fakes, remember_composed

from bench.cli import main

ROWS = ("w/o ss (no sky segmentation)", "w/o wd (no geometric loss)", "Ours (full)")
"""Those of the table that the sweeps are of, which is smaller than the bench's own."""
FULL = "Ours (full), 03, seed "
TABLE = Path(__file__).with_name("three_rows")


class Bench:
    """``bgs-bench reproduce three_rows`` in a folder, with fakes in place of runs."""

    def __init__(self, folder: Path, kitti: Path) -> None:
        self.folder = folder
        self.control = folder / "control"
        self.control.mkdir(parents=True)
        self.arguments = ["reproduce", "three_rows", f"plugins=[{TABLE}]", f"dataset.root={kitti}"]
        self.processes: list[subprocess.Popen[str]] = []
        self.behave()

    def behave(self, others: str = "ok", **by_seed: str) -> None:
        """How the runs of the row "Ours (full)" behave: ``seed0="hang"``; and the others."""
        behaviours = {"*": others} | {f"{FULL}{name.removeprefix('seed')}": how for name, how in by_seed.items()}
        (self.control / "behaviour.json").write_text(json.dumps(behaviours))

    def reproduce(self, *more: str) -> int:
        """In this process; its runs are in processes of their own."""
        before = Path.cwd()
        os.chdir(self.folder)
        try:
            with fakes(self.control):
                return main([*self.arguments, *more])
        finally:
            os.chdir(before)

    def start(self, *more: str) -> subprocess.Popen[str]:
        """In a process of its own, which does not wait."""
        remember_composed(self.control)
        script = str(Path(__file__).with_name("reproduce_with_fakes.py"))
        process = subprocess.Popen(
            [sys.executable, script, str(self.control), *self.arguments, *more],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.processes.append(process)
        return process

    def started(self) -> list[str]:
        """The labels of the runs that were started since the last call, in order."""
        file = self.control / "started.txt"
        lines = file.read_text().splitlines() if file.exists() else []
        file.unlink(missing_ok=True)
        return [line.partition(" ")[2] for line in lines]

    def hanging(self, seed: int) -> int:
        """Wait until the run of this seed hangs; its process."""
        marker = self.control / f"hangs-{seed}"
        wait_until(lambda: marker.exists() and marker.read_text() != "")
        pid = int(marker.read_text())
        marker.unlink()
        return pid

    def tables(self) -> dict[str, bytes]:
        """The written tables by file name."""
        return {file.name: file.read_bytes() for file in (self.folder / "results" / "tables").iterdir()}


def wait_until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Poll; a failed assertion when it does not come true."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.02)


def is_running(pid: int) -> bool:
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
