"""The loss terms on depth: the C++ core against their torch form with autograd, at the size of KITTI 03 to 10."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from bench.contracts.loss import LossTerm, LossValue, TorchLoss
from bench.contracts.rasterizer import Rendered
from bench.supervision.target import Target
from bench.types import PinholeView
from plugins.losses.geo import GeoConfig, GeoLoss
from plugins.losses.normal import NormalConfig, NormalLoss
from plugins.losses.smooth import SmoothConfig, SmoothLoss
from tests.performance.scenes import interleaved, report

VIEW = PinholeView(np.eye(4), 707.0912, 707.0912, 601.8873, 183.1104, 1226, 370)


def street_like() -> tuple[Rendered, Target]:
    """A ground plane with walls on both sides, stereo holes in a fifth of the pixels, a render off by 5 %."""
    generator = torch.Generator().manual_seed(3)
    y, x = torch.meshgrid(torch.arange(VIEW.height), torch.arange(VIEW.width), indexing="ij")
    ground = 1.65 * VIEW.fy / (y - VIEW.cy).clamp_min(1.0)
    walls = 6.0 * VIEW.fx / (x - VIEW.cx).abs().clamp_min(1.0)
    depth = torch.minimum(ground, walls).clamp_max(80.0).float()
    known = torch.rand(depth.shape, generator=generator) < 0.8
    target = Target(torch.rand(3, *depth.shape, generator=generator), depth * known, known, VIEW)
    shown = depth * (1 + 0.05 * torch.randn(depth.shape, generator=generator))
    alpha = (0.4 + 0.8 * torch.rand(depth.shape, generator=generator)).clamp_max(1.0)
    return Rendered(torch.zeros(3, *depth.shape), shown, alpha), target


def test_terms_on_depth_against_torch() -> None:
    rendered, target = street_like()
    terms: dict[str, LossTerm] = {
        "geo": GeoLoss(GeoConfig("geo")),
        "normal": NormalLoss(NormalConfig("normal")),
        "smooth": SmoothLoss(SmoothConfig("smooth")),
    }

    def in_torch(term: LossTerm) -> LossValue:
        assert isinstance(term, TorchLoss)
        return TorchLoss.evaluate(term, rendered, target)

    work: dict[str, Callable[[], object]] = {}
    for name, term in terms.items():
        work[f"{name}, C++ core"] = lambda term=term: term.evaluate(rendered, target)
        work[f"{name}, torch"] = lambda term=term: in_torch(term)
    seconds = interleaved(work)
    ratios = {f"{name}: torch / core": seconds[f"{name}, torch"] / seconds[f"{name}, C++ core"] for name in terms}
    report("losses", seconds, ratios)
