"""Ratios of the C++ core against yardsticks in the same run. `make bench` runs it; nothing here fails on a time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from bench.contracts.rasterizer import Gradients, Rendered
from bench.gaussians.loss_stack import LossStack
from bench.gaussians.map import GaussianMap
from bench.gaussians.optimizer import LearningRates, MapOptimizer
from bench.registry import PluginConfig, lookup
from bench.supervision.ssim import local_statistics, ssim
from bench.supervision.target import Target
from plugins.rasterizers.cpu import CpuRasterizer
from tests.performance.scenes import VIEW, elongated, interleaved, isotropic, report, with_surroundings

SIZE = (VIEW.height, VIEW.width)


def matrix_product() -> Callable[[], Tensor]:
    """The yardstick: torch.mm of 1024^3 in float32."""
    a = torch.randn(1024, 1024)
    return lambda: torch.mm(a, a)


def render_and_back(rasterizer: CpuRasterizer, planes: Tensor) -> Callable[[], Gradients]:
    grad_color, grad_depth = torch.randn(3, *SIZE), torch.randn(*SIZE)
    return lambda: rasterizer.backward(rasterizer.render(planes, VIEW), grad_color, grad_depth, None)


def whole_iteration(rasterizer: CpuRasterizer, planes: Tensor) -> Callable[[], None]:
    """Render, L1 + SSIM + sampled depth loss, backward, Adam: what one iteration of mapping does."""
    generator = torch.Generator().manual_seed(2)
    depth = 2.0 + 78.0 * torch.rand(*SIZE, generator=generator)
    everywhere = torch.ones(*SIZE, dtype=torch.bool)
    target = Target(torch.rand(3, *SIZE, generator=generator), depth, everywhere, VIEW)
    losses = LossStack([lookup("loss", n).cls(lookup("loss", n).config(name=n)) for n in ("rgb", "ssim", "geo")])
    optimizer = MapOptimizer(LearningRates(0.0, 0.0, 0.0, 0.0, 0.0))
    gaussians = GaussianMap(0, torch.device("cpu"))
    gaussians.add(0, VIEW.T_world_cam, planes, torch.ones(planes.shape[1]))

    def run() -> None:
        rendered: Rendered = rasterizer.render(gaussians.planes, VIEW)
        _, gradients = losses.evaluate(rendered, target)
        optimizer.learn(gaussians, rasterizer, rendered, gradients)

    return run


def test_rasterizer_against_matrix_product() -> None:
    rasterizer = CpuRasterizer(PluginConfig("cpu"))
    small, large, long = isotropic(100_000), isotropic(1_000_000), elongated(100_000)
    lighter = isotropic(100_000, radius_px=4.05)
    seconds = interleaved(
        {
            "torch.mm 1024^3": matrix_product(),
            "isotropic 100 k, forward": lambda: rasterizer.render(small, VIEW, differentiable=False),
            "isotropic 100 k, forward + backward": render_and_back(rasterizer, small),
            "12.8 a pixel, 100 k, forward + backward": render_and_back(rasterizer, lighter),
            "elongated 100 k, forward + backward": render_and_back(rasterizer, long),
            "isotropic 100 k, whole iteration": whole_iteration(rasterizer, small),
            "12.8 a pixel, 100 k, whole iteration": whole_iteration(rasterizer, lighter),
            "isotropic 1 M, whole iteration": whole_iteration(rasterizer, large),
        }
    )
    mm = seconds["torch.mm 1024^3"]
    workspace = rasterizer.render(large, VIEW).context[0]
    ratios = {
        "forward + backward, isotropic 100 k / mm": seconds["isotropic 100 k, forward + backward"] / mm,
        "forward + backward, 12.8 a pixel, 100 k / mm": seconds["12.8 a pixel, 100 k, forward + backward"] / mm,
        "forward + backward, elongated 100 k / mm": seconds["elongated 100 k, forward + backward"] / mm,
        "whole iteration, isotropic 100 k / mm": seconds["isotropic 100 k, whole iteration"] / mm,
        "whole iteration, 12.8 a pixel, 100 k / mm": seconds["12.8 a pixel, 100 k, whole iteration"] / mm,
        "whole iteration, 1 M / 100 k": seconds["isotropic 1 M, whole iteration"]
        / seconds["isotropic 100 k, whole iteration"],
        "scratch at 1 M, MB": workspace.bytes / 1e6,
    }
    report("rasterizer", seconds, ratios)


def test_what_lies_outside_the_view() -> None:
    """A map of 100 k Gaussians in view, alone and amid others; the goal is at most 10 ns for each of these."""
    rasterizer = CpuRasterizer(PluginConfig("cpu"))
    inside, outside = isotropic(100_000, radius_px=4.05), (500_000, 2_000_000)
    work = {f"{count:,} outside, whole iteration": with_surroundings(inside, count) for count in (0, *outside)}
    seconds = interleaved({name: whole_iteration(rasterizer, planes) for name, planes in work.items()}, rounds=8)
    alone, *amid = seconds.values()
    ratios = {f"{count:,} outside / none": value / alone for count, value in zip(outside, amid, strict=True)}
    ratios |= {
        f"wall ns for each of {count:,} outside": (value - alone) / count * 1e9
        for count, value in zip(outside, amid, strict=True)
    }
    report("outside_the_view", seconds, ratios)


def test_fused_ssim_against_conv2d() -> None:
    import bench._native as _native

    image, target = torch.rand(3, *SIZE), torch.rand(3, *SIZE)
    mean, variance = local_statistics(target)
    grad = torch.empty_like(image)
    taps = torch.exp(-(torch.arange(-5.0, 6.0) ** 2) / 4.5)
    window = (taps[:, None] * taps / taps.sum() ** 2).expand(3, 1, 11, 11).contiguous()

    def conv2d() -> None:
        leaf = image.clone().requires_grad_()
        blur = [
            torch.nn.functional.conv2d(x[None], window, padding=5, groups=3)[0]
            for x in (leaf, target, leaf * leaf, target * target, leaf * target)
        ]
        mx, my, xx, yy, xy = blur
        value = (2 * mx * my + 1e-4) * (2 * (xy - mx * my) + 9e-4)
        value = value / ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4))
        (0.8 * (leaf - target).abs().mean() + 0.2 * (1 - value.mean())).backward()

    def separable() -> None:
        leaf = image.clone().requires_grad_()
        (0.8 * (leaf - target).abs().mean() + 0.2 * (1 - ssim(leaf, target, (mean, variance)))).backward()

    seconds = interleaved(
        {
            "fused L1 + SSIM with gradient": lambda: _native.photometric(
                image, target, mean, variance, 0.8, 0.0, 0.2, grad
            ),
            "conv2d 11x11 with autograd": conv2d,
            "separable conv2d with autograd": separable,
        }
    )
    fused = seconds["fused L1 + SSIM with gradient"]
    ratios = {
        "conv2d / fused": seconds["conv2d 11x11 with autograd"] / fused,
        "separable conv2d / fused": seconds["separable conv2d with autograd"] / fused,
    }
    report("ssim", seconds, ratios)


def test_torch_projection_against_ours_whole() -> None:
    """gsplat's projection alone, in torch with autograd, against our whole forward and backward pass."""
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed (pip install gsplat)")
    planes = isotropic(100_000)
    K = torch.tensor([[VIEW.fx, 0.0, VIEW.cx], [0.0, VIEW.fy, VIEW.cy], [0.0, 0.0, 1.0]])[None]

    def project() -> None:
        leaf = planes.clone().requires_grad_()
        covariance, _ = reference._quat_scale_to_covar_preci(leaf[6:10].T, leaf[3:6].T.exp(), True, False)
        _, means2d, depths, conics, _ = reference._fully_fused_projection(
            leaf[0:3].T, covariance, torch.eye(4)[None], K, VIEW.width, VIEW.height
        )
        (means2d.sum() + depths.sum() + conics.sum()).backward()

    rasterizer = CpuRasterizer(PluginConfig("cpu"))
    seconds = interleaved({"gsplat's torch projection": project, "our whole pass": render_and_back(rasterizer, planes)})
    ratio = seconds["gsplat's torch projection"] / seconds["our whole pass"]
    report("projection", seconds, {"torch projection / our whole pass": ratio})
