"""`bgs-bench table` as a whole command. `make bench` runs it; nothing here fails on a time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import yaml  # type: ignore[import-untyped]

from tests.performance.scenes import interleaved, report
from tests.performance.thousand_runs import make_thousand_runs


def test_a_table_of_a_thousand_runs(tmp_path: Path) -> None:
    """Against the same command without runs, and against what parsing twelve of the configs by PyYAML takes."""
    runs = tmp_path / "runs"
    make_thousand_runs(runs)
    configs = [(folder / "config.yaml").read_text() for folder in sorted(runs.glob("*_0"))]

    def command(*arguments: str) -> None:
        whole = [sys.executable, "-m", "bench.cli", "table", "main_kitti", *arguments]
        subprocess.run(whole, cwd=tmp_path, capture_output=True, check=True)

    seconds = interleaved(
        {
            "1,008 run folders": lambda: command("runs"),
            "no run": lambda: command(),
            "PyYAML, 12 configs": lambda: [yaml.safe_load(text) for text in configs],
        },
        rounds=3,
    )
    whole = seconds["1,008 run folders"]
    report(
        "table",
        seconds,
        {"1,008 / no run": whole / seconds["no run"], "1,008 / PyYAML on 12": whole / seconds["PyYAML, 12 configs"]},
    )
