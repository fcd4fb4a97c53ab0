"""Seconds and memory of one iteration of mapping, and where its time goes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import torch

from bench.contracts.rasterizer import Rasterizer
from bench.gaussians.loss_stack import LossStack
from bench.gaussians.map import GaussianMap
from bench.gaussians.optimizer import LearningRates, MapOptimizer
from bench.registry import PluginConfig, build, lookup
from bench.supervision.target import Target
from bench.types import PinholeView
from tests.performance.scenes import VIEW, isotropic
from tools.gpu_check.device import staged, yardstick

COUNTS = (100_000, 1_000_000, 5_000_000)
LOSSES = ("rgb", "ssim", "geo")


def measure(
    rasterizer: str = "gsplat", counts: Sequence[int] = COUNTS, rounds: int = 20, view: PinholeView = VIEW
) -> Iterator[dict[str, Any]]:
    """Yields the rows so far, one for each number of Gaussians: milliseconds of the fastest of ``rounds`` iterations by
    stage and in all, the most memory in GB, and the yardstick at that time."""
    mine: Rasterizer = build(PluginConfig(rasterizer), "rasterizer")
    rows: list[dict[str, Any]] = []
    for count in counts:
        row: dict[str, Any] = {"gaussians": count, **yardstick()}
        rows.append(row)
        try:
            row |= _measured(mine, count, rounds, view)
        except torch.cuda.OutOfMemoryError:
            row["reason"] = "out of memory"
        yield {"losses": LOSSES, "image": [view.width, view.height], "rows": rows}


def _measured(mine: Rasterizer, count: int, rounds: int, view: PinholeView) -> dict[str, Any]:
    on_gpu = mine.device.type == "cuda"
    if on_gpu:
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    stages = _stages(mine, isotropic(count), view)
    for _ in range(2):  # kernels are loaded, memory is taken
        staged(mine.device, stages)
    best = min((staged(mine.device, stages) for _ in range(rounds)), key=lambda spans: sum(spans.values()))
    return {
        "step_ms": sum(best.values()),
        "stages_ms": best,
        "gpu_memory_gb": torch.cuda.max_memory_allocated() / 1e9 if on_gpu else None,
    }


def _stages(mine: Rasterizer, planes: torch.Tensor, view: PinholeView) -> dict[str, Callable[[], object]]:
    """An iteration as the mapper makes it, in stages that hand on what they made."""
    device, generator = mine.device, torch.Generator().manual_seed(2)
    shape = (view.height, view.width)
    image, depth = torch.rand(3, *shape, generator=generator), 2.0 + 78.0 * torch.rand(*shape, generator=generator)
    everywhere = torch.ones(*shape, dtype=torch.bool)
    target = Target(image.to(device), depth.to(device), everywhere.to(device), view)
    losses = LossStack([lookup("loss", name).cls(lookup("loss", name).config(name=name)) for name in LOSSES])
    optimizer = MapOptimizer(LearningRates(0.0, 0.0, 0.0, 0.0, 0.0))
    gaussians = GaussianMap(0, device)
    gaussians.add(0, np.eye(4), planes.to(device), torch.ones(planes.shape[1], device=device))
    made: dict[str, Any] = {}

    def render() -> None:
        made["rendered"] = mine.render(gaussians.planes, view)

    def evaluate() -> None:
        made["by_images"] = losses.evaluate(made["rendered"], target)[1]

    def back() -> None:
        made["gradients"] = mine.backward(made["rendered"], *made["by_images"])

    def step() -> None:
        optimizer.step(gaussians, made["gradients"])

    return {"render": render, "losses": evaluate, "backward": back, "adam": step}
