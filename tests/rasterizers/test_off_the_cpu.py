"""Whole runs with the map on a device that is not the CPU, as with gsplat on a GPU: here on a pretended one."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from torch import Tensor

from bench.config import compose_run
from bench.contracts.rasterizer import Gradients, Rendered
from bench.evaluation.run_evaluators import evaluate_run
from bench.registry import PluginConfig, register
from bench.slam.run import run_system
from bench.types import PinholeView
from plugins.rasterizers.cpu import CpuRasterizer
from tests.pretended_device import DEVICE, Pretended, pretended_device

SMALL = (
    *("dataset=street", "dataset.frames=2", "dataset.width=64", "dataset.height=32", "tracker=groundtruth"),
    *("cache.enabled=false", "pipeline=sequential", "protocol.lpips=false", "protocol.right_view=false"),
    *("mapper.iterations=2", "mapper.final_coarse_iterations=1", "mapper.final_iterations=2"),
)
MANY_PARTS = (
    *("mapper.exposure=true", "mapper.pose_refinement=0.5", "mapper.camera_color=affine", "mapper.right_images=0.5"),
    *("mapper.moving=true", "mapper.sh_degree=1", "loss=[rgb,mse,ssim,geo,normal,smooth]"),
)


class ElsewhereRasterizer(CpuRasterizer):
    """The C++ core behind a transfer: takes and gives tensors of the pretended device."""

    learns = False

    def __init__(self, config: PluginConfig) -> None:
        super().__init__(config)
        self.device = DEVICE

    def render(self, planes: Tensor, view: PinholeView, differentiable: bool = True) -> Rendered:
        assert isinstance(planes, Pretended)
        made = super().render(planes.cpu(), view, differentiable)
        return Rendered(made.color.to(DEVICE), made.depth.to(DEVICE), made.alpha.to(DEVICE), made.context)

    def backward(self, rendered: Rendered, *by_images: Tensor | None, **given: Any) -> Gradients:
        assert all(grad is None or isinstance(grad, Pretended) for grad in by_images)
        back = super().backward(rendered, *(None if grad is None else grad.cpu() for grad in by_images), **given)
        twist = None if back.twist is None else back.twist.to(DEVICE)
        return Gradients(back.planes.to(DEVICE), back.touched.to(DEVICE), twist)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "within_db"), [("elsewhere", 0.1), pytest.param("gsplat", 0.5, marks=pytest.mark.cuda)]
)
def test_a_run_is_that_of_the_cpu(name: str, within_db: float, tmp_path: Path, clean_registry: None) -> None:
    """The same iterations, their losses and steps by torch in place of the core: but for rounding the same map."""
    register("rasterizer", "elsewhere")(ElsewhereRasterizer)
    psnr = []
    for rasterizer in ("cpu", name):
        given = (f"mapper.rasterizer={rasterizer}", f"output={tmp_path / rasterizer}")
        with pretended_device() if rasterizer == "elsewhere" else nullcontext():
            folder = run_system(compose_run([*SMALL, *MANY_PARTS, *given]))
        psnr.append(evaluate_run(folder.path)["views"]["left"]["psnr_db"])
    assert psnr[0] == pytest.approx(psnr[1], abs=within_db)
