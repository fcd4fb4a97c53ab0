"""Where the time of a frame goes, on real KITTI frames. `make bench` runs it; nothing here fails on a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import bench.slam.run
from bench.config import compose_run
from bench.evaluation.run_evaluators import evaluate_run
from bench.gaussians.loss_stack import LossStack
from bench.gaussians.optimizer import MapOptimizer
from bench.runs.status import read_json
from plugins.mappers.gaussian import GaussianMapper
from plugins.rasterizers.cpu import CpuRasterizer
from tests.performance.scenes import report_shares

STAGES = (
    (GaussianMapper, "_seed", "seeding"),
    (GaussianMapper, "_target", "targets of keyframes"),
    (CpuRasterizer, "render", "rendering, forward"),
    (CpuRasterizer, "backward", "rendering, backward"),
    (LossStack, "evaluate", "losses"),
    (MapOptimizer, "step", "Adam"),
)


def timed(
    function: Callable[..., Any], seconds: dict[str, float], stage: str, stack: list[float]
) -> Callable[..., Any]:
    """The function, adding the time spent in it, less that in other timed functions that it calls."""

    def wrapper(*args: Any, **kwargs: Any) -> Any:
        start = time.perf_counter()
        stack.append(0.0)
        try:
            return function(*args, **kwargs)
        finally:
            took = time.perf_counter() - start
            seconds[stage] = seconds.get(stage, 0.0) + took - stack.pop()
            if stack:
                stack[-1] += took

    return wrapper


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("system", ["bgs_slam", "bgs_slam_fast"])
def test_shares_of_a_frame(system: str, test_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One stage after the other (`pipeline=sequential`), so that each one has both cores to itself."""
    seconds: dict[str, float] = {}
    stack: list[float] = []
    for owner, name, stage in STAGES:
        monkeypatch.setattr(owner, name, timed(getattr(owner, name), seconds, stage, stack))
    save_views = bench.slam.run.save_views

    def saved_views(*args: Any) -> None:
        before = dict(seconds)  # its renders are no part of a frame
        save_views(*args)
        seconds.clear()
        seconds.update(before)

    monkeypatch.setattr(bench.slam.run, "save_views", saved_views)
    root = test_data / "kitti_odometry"
    config = compose_run(
        [
            *("dataset=kitti", f"dataset.root={root}", "dataset.sequence=06", "dataset.frames=0:10"),
            *(f"system={system}", "protocol.holdout_every=5", "pipeline=sequential", f"output={tmp_path / 'run'}"),
        ]
    )
    folder = bench.slam.run.run_system(config)
    frames = 10
    resources = read_json(folder.path / "resources.json")
    per_frame = {name: value / frames for name, value in seconds.items()}
    mapping = resources["mapping_s_per_frame"]
    per_frame["other parts of mapping"] = mapping - sum(per_frame.values())
    per_frame |= {stage: resources[f"{stage}_s_per_frame"] for stage in ("tracking", "stereo")}
    start = time.perf_counter()
    evaluate_run(folder.path)
    report_shares(f"shares_{system}", per_frame, {"evaluation": (time.perf_counter() - start) / frames})
