"""A table by real, tiny runs: the two commands that make it agree, and a run made again has the same numbers."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from fake_bench import TABLE

from bench.cli import main
from tests.short_runs import FEW_ITERATIONS

TINY = (*FEW_ITERATIONS, "tracker=groundtruth", "dataset.frames=0:2", "protocol.lpips=false", "cache.enabled=false")


def written(folder: Path) -> dict[str, bytes]:
    """The tables by file name, but for the copy of the runs, which holds times."""
    files = (folder / "results" / "tables").glob("three_rows.*")
    # How fast the machine was then is a run's own.
    yardstick = re.compile(rb", mm 1024.{1,24}?3 \d+( to \d+)? ms")
    return {file.name: yardstick.sub(b"", file.read_bytes()) for file in files if file.suffix != ".json"}


@pytest.mark.slow
def test_reproduce_finds_what_the_experiment_made(
    tmp_path: Path, kitti: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    overrides = [f"dataset.root={kitti}", f"plugins=[{TABLE}]", *TINY]
    assert main(["run", "-m", "experiment=three_rows", *overrides, "seed=0"]) == 0
    runs = tmp_path / "results" / "runs"
    assert len(list(runs.glob("*/metrics.json"))) == 3
    capfd.readouterr()
    assert main(["reproduce", "three_rows", *overrides, "--seeds", "0"]) == 0
    assert "3 runs, 0 to make" in capfd.readouterr().out
    tables = written(tmp_path)

    gone = sorted(runs.glob("*/metrics.json"))[1].parent
    before = json.loads((gone / "metrics.json").read_text())
    shutil.rmtree(gone)
    assert main(["reproduce", "three_rows", *overrides, "--seeds", "0", "--jobs", "2"]) == 0
    assert "3 runs, 1 to make, 2 at once" in capfd.readouterr().out
    after = json.loads((gone / "metrics.json").read_text())
    assert (after["views"], after["trajectory"]) == (before["views"], before["trajectory"])
    assert written(tmp_path) == tables


def test_an_experiment_needs_a_sweep(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "experiment=ablation"]) == 2
    assert capfd.readouterr().err == "bgs-bench: experiment= stands for many runs; add -m.\n"
