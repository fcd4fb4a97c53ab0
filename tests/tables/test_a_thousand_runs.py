"""A table of a thousand run folders; how long it takes is measured in tests/performance."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.performance.thousand_runs import make_thousand_runs


@pytest.mark.slow
def test_a_thousand_run_folders_make_a_table(tmp_path: Path) -> None:
    make_thousand_runs(tmp_path / "runs")
    command = [sys.executable, "-m", "bench.cli", "table", "main_kitti", "runs", "--format", "md"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    # The mean of 20 .. 103, with the sample deviation of 84 numbers in steps of one: sqrt(84 * 85 / 12).
    assert done.stdout.count("61.50 ± 24.39** (84") == 12 + 2


def test_a_table_does_without_torch(tmp_path: Path) -> None:
    """Its import alone takes as long as a thousand run folders."""
    code = "import sys; from bench.cli import main; main(['table', 'ablation']); print('torch.nn' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "False"
