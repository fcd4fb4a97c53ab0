"""What following a run costs it. `make bench` runs it; nothing here fails on a time."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.config import compose_run
from bench.slam.run import run_system
from tests.performance.scenes import interleaved, report


@pytest.mark.timeout(1200)
def test_cost_of_a_recording(tmp_path: Path) -> None:
    """The same run with `viewer=rerun`, into a file, and without; at KITTI's shape and half its sides."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'bgs-slam-bench[rerun]'")

    def run(*viewer: str) -> None:
        street = ("dataset.frames=10", "dataset.width=620", "dataset.height=188", "cache.enabled=false")
        run_system(compose_run([*street, "system=bgs_slam_fast", f"output={tmp_path / 'run'}", "rerun=true", *viewer]))

    seconds = interleaved(
        {"alone": run, "recorded": lambda: run("viewer=rerun", f"viewer.save={tmp_path / 'run.rrd'}")}, rounds=3
    )
    report("viewer", seconds, {"recorded / alone": seconds["recorded"] / seconds["alone"]})
