"""Tiny real runs by every launcher: the same numbers and the same table as the basic launcher's, to the byte."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

from bench.cli import main
from tests.short_runs import FEW_ITERATIONS, SMALL_STREET

# Runs of a street; what a run learns differs between the seeds.
RUNS = ("run", "-m", *SMALL_STREET, *FEW_ITERATIONS[:2], "tracker=groundtruth", "protocol.lpips=false")
# RAY_ADDRESS: another's cluster, which a sweep does not join unless it is told to.
RAY = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_ADDRESS": "127.0.0.1:9"}
LAUNCHERS = {
    "joblib": ("hydra_joblib_launcher", ("--jobs", "2")),
    "slurm_local": ("hydra_submitit_launcher", ("--jobs", "2")),
    "ray": ("hydra_ray_launcher", ("hydra.launcher.ray.init.num_cpus=2",)),
}


def sweep(folder: Path, *more: str) -> int:
    """Make the runs in ``folder``/runs, by processes of their own; the exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, value in (RAY | {"OMP_NUM_THREADS": "1", "COLUMNS": "400"}).items():
            patch.setenv(name, value)
        return main([*RUNS, "output=runs", *more])


def numbers(folder: Path) -> dict[str, Any]:
    """What the runs were scored, by their folders' names, but for times and memory; and their maps."""
    found: dict[str, Any] = {}
    for run in sorted((folder / "runs").glob("*/metrics.json")):
        metrics = json.loads(run.read_text())
        found[run.parent.name] = {key: metrics[key] for key in ("views", "trajectory", "protocol", "map")}
        found[f"{run.parent.name}/map"] = (run.parent / "map.ply").read_bytes()
    return found


@pytest.fixture(scope="module")
def basic(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("basic")
    assert sweep(folder, "seed=0,1", "--jobs", "2") == 0
    scores = numbers(folder)
    assert len(scores) == 4
    assert len({json.dumps(value["views"]) for name, value in scores.items() if "/" not in name}) == 2
    return scores


@pytest.mark.slow
@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_the_numbers_of_the_basic_launcher(
    tmp_path: Path, basic: dict[str, Any], launcher: str, capfd: pytest.CaptureFixture[str]
) -> None:
    module, options = LAUNCHERS[launcher]
    if importlib.util.find_spec("hydra_plugins") is None or importlib.util.find_spec(f"hydra_plugins.{module}") is None:
        pytest.skip(f"launcher={launcher} is not installed")
    assert sweep(tmp_path, "seed=1", f"launcher={launcher}", *options) == 0
    assert capfd.readouterr().err == ""
    found = numbers(tmp_path)
    assert len(found) == 2
    assert found == {name: basic[name] for name in found}
    assert sweep(tmp_path, "seed=1", f"launcher={launcher}", *options) == 0
    assert "started" not in capfd.readouterr().out
