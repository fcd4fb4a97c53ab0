"""A thousand run folders make a table in five seconds, the start of the process included."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.performance.thousand_runs import make_thousand_runs


@pytest.mark.slow
def test_a_thousand_run_folders_make_a_table_in_five_seconds(tmp_path: Path) -> None:
    count = make_thousand_runs(tmp_path / "runs")
    command = [sys.executable, "-m", "bench.cli", "table", "main_kitti", "runs", "--format", "md"]
    started = time.perf_counter()
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    seconds = time.perf_counter() - started
    print(f"{count} runs: {seconds:.2f} s")
    assert seconds < 5
    # The mean of 20 .. 103, with the sample deviation of 84 numbers in steps of one: sqrt(84 * 85 / 12).
    assert done.stdout.count("61.50 ± 24.39** (84") == 12 + 2


def test_a_table_does_without_torch(tmp_path: Path) -> None:
    """Its import alone takes as long as a thousand run folders."""
    code = "import sys; from bench.cli import main; main(['table', 'ablation']); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "False"
