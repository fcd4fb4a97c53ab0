"""``bgs-bench`` in a fresh process, where nothing but files carries over, and the settings of a tiny run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.short_runs import FEW_ITERATIONS

TINY = (
    *("dataset.frames=4", "dataset.width=160", "dataset.height=64", *FEW_ITERATIONS),
    *("tracker=groundtruth", "protocol.lpips=false"),
)


def python(arguments: list[str], cwd: Path, **environment: str) -> str:
    """Standard output of this Python with these arguments; fails the test unless it succeeds."""
    process = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        # One thread, and a terminal wide enough that a message is one line.
        env=os.environ | {"OMP_NUM_THREADS": "1", "COLUMNS": "400"} | environment,
        timeout=240,
        check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def bgs_bench(*arguments: str, cwd: Path, **environment: str) -> str:
    """Standard output of ``bgs-bench`` with these arguments."""
    return python(["-m", "bench.cli", *arguments], cwd, **environment)
