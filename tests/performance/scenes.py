"""The two gate scenes of the rasterizer's benchmarks, and how to time several things fairly."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bench.gaussians.parameters import planes_from
from bench.types import PinholeView

ROUNDS = 20
REPORT = Path("results/performance")
VIEW = PinholeView(np.eye(4), 718.856, 718.856, 607.1928, 185.2157, 1241, 376)


def _centers(count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Positions spread evenly over the image and evenly in log depth from 2 to 80 m; depths (N,)."""
    z = 2.0 * torch.exp(torch.rand(count, generator=generator) * np.log(40.0))
    u = torch.rand(count, generator=generator) * VIEW.width
    v = torch.rand(count, generator=generator) * VIEW.height
    return torch.stack([(u - VIEW.cx) / VIEW.fx * z, (v - VIEW.cy) / VIEW.fy * z, z], 1), z


def isotropic(count: int, radius_px: float = 5.0) -> Tensor:
    """Near-isotropic Gaussians, 3 sigma about ``radius_px`` on the image (low-pass included), opacity 0.05 to 0.95.

    100 k of them reach a pixel 19.6 times on average (alpha >= 1/255) with 5 px, and 12.8 times with 4.05 px.
    """
    generator = torch.Generator().manual_seed(0)
    means, z = _centers(count, generator)
    sigma_px = np.sqrt((radius_px / 3.0) ** 2 - 0.3)
    scales = (z / VIEW.fx * sigma_px)[:, None] * torch.exp(0.1 * torch.randn(count, 3, generator=generator))
    opacities = 0.05 + 0.9 * torch.rand(count, generator=generator)
    quaternions = torch.randn(count, 4, generator=generator)
    return planes_from(means, scales, quaternions, opacities, torch.rand(count, 3, generator=generator))


def with_surroundings(planes: Tensor, count: int) -> Tensor:
    """The map amid ``count`` more Gaussians that the view does not show: half behind the camera, half beside it."""
    outside = isotropic(count)
    behind, beside = outside[:, : count // 2], outside[:, count // 2 :]
    behind[2] *= -1.0
    beside[0] = 3.0 * beside[2]
    return torch.cat([behind, planes, beside], 1)


def elongated(count: int) -> Tensor:
    """Opaque splats of 6:1, as a trained map has them on surfaces: opacity 0.9 to 0.99."""
    generator = torch.Generator().manual_seed(1)
    means, z = _centers(count, generator)
    short = z / VIEW.fx * 1.0
    scales = torch.stack([6.0 * short, short, 0.2 * short], 1)
    opacities = 0.9 + 0.09 * torch.rand(count, generator=generator)
    quaternions = torch.randn(count, 4, generator=generator)
    return planes_from(means, scales, quaternions, opacities, torch.rand(count, 3, generator=generator))


def interleaved(work: dict[str, Callable[[], object]], rounds: int = ROUNDS) -> dict[str, float]:
    """Minimum seconds of each piece of work over ``rounds`` rounds; every round runs each of them once, in turn."""
    best = dict.fromkeys(work, float("inf"))
    for _ in range(rounds):
        for name, run in work.items():
            start = time.perf_counter()
            run()
            best[name] = min(best[name], time.perf_counter() - start)
    return best


def report(name: str, seconds: dict[str, float], ratios: dict[str, float]) -> None:
    """Print a table and write ``results/performance/<name>.json``; a benchmark never fails on a time."""
    REPORT.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"milliseconds": {k: 1e3 * v for k, v in seconds.items()}, "ratios": ratios}, indent=2)
    (REPORT / f"{name}.json").write_text(text + "\n")
    print(f"\n{name}")
    for key, value in seconds.items():
        print(f"  {key:45s} {1e3 * value:9.2f} ms")
    for key, value in ratios.items():
        print(f"  {key:45s} {value:9.2f}")


def report_shares(name: str, seconds: dict[str, float], beside: dict[str, float]) -> None:
    """Print what share of a frame each stage takes, and write ``results/performance/<name>.json``.

    ``seconds`` a frame add up to the frame; what is ``beside`` it (the evaluation afterwards) is given as a multiple.
    """
    whole = sum(seconds.values())
    shares = {stage: value / whole for stage, value in (seconds | beside).items()}
    REPORT.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"seconds_per_frame": seconds | beside, "shares_of_a_frame": shares}, indent=2)
    (REPORT / f"{name}.json").write_text(text + "\n")
    print(f"\n{name}: {whole:.3f} s per frame")
    for stage, share in sorted(shares.items(), key=lambda item: -item[1]):
        print(f"  {stage:45s} {100 * share:6.1f} %" + ("  (after the run)" if stage in beside else ""))
