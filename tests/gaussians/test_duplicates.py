"""A wall seen in two passes: what the second has twice goes, what only it has stays."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.gaussians.duplicates import duplicates
from bench.gaussians.parameters import planes_from
from bench.types import PinholeView
from plugins.rasterizers.cpu import CpuRasterizer, PluginConfig

RASTERIZER = CpuRasterizer(PluginConfig())


def wall(left: float, right: float, z: float = 4.0, black: bool = False, seed: int = 0) -> Tensor:
    """Discs 10 cm apart from x = left to right, y = -1 to 1, in colours that vary with the place."""
    x, y = np.meshgrid(np.arange(left + 0.05, right, 0.1), np.arange(-0.95, 1, 0.1))
    means = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], 1)
    means += np.random.default_rng(seed).normal(scale=0.01, size=means.shape)
    colors = np.full(means.shape, -0.2) if black else 0.5 + 0.3 * np.sin(3 * means + [0, 1, 2])
    size, turn = np.full(means.shape, 0.07), np.tile([1.0, 0, 0, 0], (len(means), 1))
    arrays = (means, size, turn, np.full(len(means), 0.95), colors)
    return planes_from(*(torch.from_numpy(a.astype(np.float32)) for a in arrays))


def views(of: Tensor) -> list[tuple[PinholeView, Tensor]]:
    """Three views of the wall, 20 cm apart, and what they show of a map."""
    found = []
    for k in range(3):
        T = np.eye(4)
        T[0, 3] = 0.2 * k
        view = PinholeView(T, 40.0, 40.0, 31.5, 15.5, 64, 32)
        found.append((view, RASTERIZER.render(of, view, differentiable=False).color))
    return found


@pytest.mark.parametrize("degree", [0, 2])
def test_what_both_have_goes_and_what_is_new_stays(degree: int) -> None:
    old, again, more = wall(-2, 1), wall(-2, 1, seed=1), wall(1, 2.4, seed=1)
    behind = wall(-2, 1, z=-4)  # no view sees it
    new = torch.cat([again, more, behind], 1)
    seen = views(torch.cat([wall(-2, 1, seed=2), wall(1, 2.4, seed=2)], 1))
    new = torch.cat([new, torch.zeros(3 * ((degree + 1) ** 2 - 1), new.shape[1])])
    old = torch.cat([old, torch.zeros(len(new) - len(old), old.shape[1])])
    gone = duplicates(old, new, seen, RASTERIZER)
    parts = gone.split([again.shape[1], more.shape[1], behind.shape[1]])
    assert float(parts[0].float().mean()) > 0.95
    assert float(parts[1].float().mean()) < 0.1
    assert bool(parts[2].all())
    assert torch.equal(gone, duplicates(old, new, seen, RASTERIZER))


def test_what_is_black_has_weight_too() -> None:
    old, new = wall(-2, 2), wall(-0.5, 0.5, z=3.0, black=True)
    gone = duplicates(old, new, views(torch.cat([old, new], 1)), RASTERIZER)
    assert float(gone.float().mean()) < 0.2  # its upper and lower ends have no wall behind them


def test_empty_maps() -> None:
    old, seen = wall(-2, 1), views(wall(-2, 1))
    assert duplicates(old, old[:, :0], seen, RASTERIZER).shape == (0,)
    assert not bool(duplicates(old[:, :0], wall(-1, 1), seen, RASTERIZER).any())
    assert bool(duplicates(old, old, [], RASTERIZER).all())
