"""Made-up renders and targets for the loss tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from bench.contracts.rasterizer import Rendered
from bench.supervision.target import Target
from bench.types import PinholeView


def view_of(height: int, width: int, focal: float = 20.0) -> PinholeView:
    """A camera at the origin with its principal point a little off the middle."""
    return PinholeView(np.eye(4), focal, 1.1 * focal, 0.45 * width, 0.55 * height, width, height)


def random_case(height: int, width: int, seed: int) -> tuple[Rendered, Target]:
    """Images of noise, rendered and stereo depth between 3 and 8 m, a mask with holes, alpha 0.05 to 1, any
    confidence; float32."""
    rng = np.random.default_rng(seed)

    def tensor(low: float, high: float, *shape: int) -> torch.Tensor:
        return torch.from_numpy(rng.uniform(low, high, shape).astype(np.float32))

    mask = torch.from_numpy(rng.random((height, width)) < 0.8)
    depth = tensor(3, 8, height, width) * mask
    target = Target(tensor(0, 1, 3, height, width), depth, mask, view_of(height, width))
    rendered = Rendered(
        tensor(-0.1, 1.2, 3, height, width), tensor(3, 8, height, width), tensor(0.05, 1, height, width)
    )
    return rendered, replace(target, confidence=tensor(0, 1, height, width))


def flat_target(depth: torch.Tensor, view: PinholeView, mask: torch.Tensor | None = None) -> Target:
    """A target with a uniformly grey image, for terms that look at depth only."""
    known = torch.ones_like(depth, dtype=torch.bool) if mask is None else mask
    grey = torch.full((3, *depth.shape), 0.5, dtype=depth.dtype)
    return Target(grey, depth * known, known, view)


def in_double(rendered: Rendered, target: Target) -> tuple[Rendered, Target]:
    """The same case in float64, where the terms run in torch: the oracle of the C++ core."""
    return (
        Rendered(rendered.color.double(), rendered.depth.double(), rendered.alpha.double()),
        Target(
            target.image.double(),
            target.depth.double(),
            target.depth_mask,
            target.view,
            None if target.confidence is None else target.confidence.double(),
        ),
    )
