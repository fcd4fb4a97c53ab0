"""Merged Gaussians against moments worked by hand, and areas by quadrature."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.errors import BenchError
from bench.gaussians.levels import mean_projected_area, merged
from bench.gaussians.parameters import NamedParameters, planes_from
from bench.gaussians.schema import COLOR, HARMONICS, OPACITY_LOGIT, planes_of
from bench.types import PinholeView
from plugins.rasterizers.cpu import CpuRasterizer, PluginConfig


def spheres(means: list[list[float]], sigma: list[float], opacity: list[float], red: list[float]) -> Tensor:
    size = torch.tensor(sigma)[:, None].repeat(1, 3)
    turn = torch.tensor([[1.0, 0, 0, 0]]).repeat(len(sigma), 1)
    return planes_from(torch.tensor(means), size, turn, torch.tensor(opacity), torch.tensor(red)[:, None].repeat(1, 3))


def cloud(count: int, degree: int = 0, seed: int = 0) -> Tensor:
    """Discs in a box of 4 m, 5 to 20 cm large."""
    random = torch.Generator().manual_seed(seed)
    planes = torch.randn(planes_of(degree), count, generator=random)
    planes[:3] = 4 * torch.rand(3, count, generator=random)
    planes[3:6] = torch.log(0.05 + 0.15 * torch.rand(3, count, generator=random)) - torch.tensor([[0], [0], [1.5]])
    return planes


def test_the_area_of_ellipsoids() -> None:
    axes = np.random.default_rng(0).uniform(0.1, 2, (20, 3))
    k = np.arange(20000) + 0.5  # directions of a Fibonacci sphere
    z, turn = 1 - 2 * k / len(k), np.pi * (1 + 5**0.5) * k
    n = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)
    others = np.stack([axes[:, 1] * axes[:, 2], axes[:, 0] * axes[:, 2], axes[:, 0] * axes[:, 1]], 1)
    exact = np.pi * np.sqrt((others**2) @ (n.T**2)).mean(1)
    np.testing.assert_allclose(mean_projected_area(axes), exact, rtol=0.011)
    assert mean_projected_area(np.array([[2.0, 2, 2]])) == pytest.approx(4 * np.pi)


def test_two_by_hand() -> None:
    """Areas 3.14 x 0.01 and 3.14 x 0.04 times opacities 0.6 and 0.3 are weights of 1 to 2."""
    planes = spheres([[0.1, 0.5, 0.5], [0.7, 0.5, 0.5]], [0.1, 0.2], [0.6, 0.3], [0.3, 0.9])
    (one,) = (NamedParameters(merged(planes, 1.0, 0.0)),)
    np.testing.assert_allclose(one.means, [[0.5, 0.5, 0.5]], rtol=1e-6)
    round_ = (0.01 + 2 * 0.04) / 3 + 1 / 12
    along = round_ + (0.4**2 + 2 * 0.2**2) / 3
    np.testing.assert_allclose(np.sort(one.scales[0]), np.sqrt([round_, round_, along]), rtol=1e-5)
    longest = int(one.scales[0].argmax())
    w, x, y, z = one.quaternions[0].double().numpy()
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(np.abs(R[:, longest]), [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(one.colors, np.full((1, 3), 0.7), rtol=1e-6)


@pytest.mark.parametrize("pixel_m", [0.0, 0.3])
def test_two_equal_ones_cover_twice_what_one_covers(pixel_m: float) -> None:
    planes = spheres([[0.5, 0.5, 0.5]] * 2, [0.1] * 2, [0.2] * 2, [0.4] * 2)
    one = NamedParameters(merged(planes, 1.0, pixel_m))
    np.testing.assert_allclose(one.scales, np.full((1, 3), (0.01 + 1 / 12) ** 0.5), rtol=1e-6)
    low_pass = 0.3 * pixel_m**2
    expected = 2 * 0.2 * (0.01 + low_pass) / (0.01 + 1 / 12 + low_pass)
    np.testing.assert_allclose(one.opacities, [expected], rtol=1e-6)
    np.testing.assert_allclose(one.colors, np.full((1, 3), 0.4), rtol=1e-6)


def test_opacity_ends_below_one() -> None:
    planes = spheres([[0.5, 0.5, 0.5]] * 9, [0.3] * 9, [0.9] * 9, [0.4] * 9)
    assert float(NamedParameters(merged(planes, 1.0, 0.0)).opacities) == pytest.approx(0.99)


def test_what_is_all_transparent_stays_a_number() -> None:
    planes = spheres([[0.5, 0.5, 0.5]] * 2, [0.1] * 2, [0.2] * 2, [0.4] * 2)
    planes[OPACITY_LOGIT] = -1e4
    after = merged(planes, 1.0, 0.0)
    assert after.shape[1] == 1
    assert bool(torch.isfinite(after).all())


def test_what_stays() -> None:
    """Alone in a cell, on the other side of zero, or too large."""
    planes = spheres([[0.5] * 3, [1.5] * 3, [-0.5] * 3, [0.6] * 3], [0.1, 0.1, 0.1, 0.6], [0.5] * 4, [0.2] * 4)
    assert torch.equal(merged(planes, 1.0, 0.0), planes)
    more = torch.cat([planes, planes[:, :1]], 1)
    after = merged(more, 1.0, 0.0)
    assert torch.equal(after[:, :3], planes[:, 1:])
    np.testing.assert_allclose(after[:3, 3], [0.5] * 3, rtol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_degree(degree: int) -> None:
    planes = cloud(300, degree)
    after = merged(planes, 1.0, 0.1)
    cells = {tuple(cell) for cell in planes[:3].floor().T.tolist()}
    assert after.shape == (planes_of(degree), len(cells))
    assert torch.equal(after, merged(planes, 1.0, 0.1))
    assert merged(planes[:, :0], 1.0, 0.1).shape == (planes_of(degree), 0)
    flat = merged(planes[: COLOR.stop], 1.0, 0.1)
    assert torch.equal(after[: COLOR.stop], flat)  # harmonics change nothing else
    constant = planes.clone()
    constant[HARMONICS] = 0.25
    torch.testing.assert_close(merged(constant, 1.0, 0.1)[HARMONICS], torch.full_like(after[HARMONICS], 0.25))


def test_the_covered_area_stays() -> None:
    planes = cloud(3000)
    planes[OPACITY_LOGIT] -= 4  # so that no opacity reaches its end

    def covered(of: Tensor) -> float:
        named = NamedParameters(of.double())
        filtered = np.sqrt(named.scales.numpy() ** 2 + 0.3 * 0.1**2)
        return float((named.opacities.numpy() * mean_projected_area(filtered)).sum())

    after = merged(planes, 0.5, 0.1)
    assert after.shape[1] < 600
    assert covered(after) == pytest.approx(covered(planes), rel=1e-5)


def test_from_afar_it_looks_the_same() -> None:
    """A wall by an eighth of its Gaussians, in cells of 2 pixels."""
    random = np.random.default_rng(0)
    means = np.stack([*random.uniform(-4, 4, (2, 6000)), random.uniform(-0.1, 0.1, 6000)], 1)
    colors = 0.5 + 0.4 * np.sin(means[:, :2] / 2 @ random.normal(size=(2, 3)))
    arrays = (means, np.full((6000, 3), 0.06), np.tile([1.0, 0, 0, 0], (6000, 1)), np.full(6000, 0.7), colors)
    planes = planes_from(*(torch.from_numpy(a.astype(np.float32)) for a in arrays))
    pose = np.eye(4)
    pose[2, 3] = -50.0
    view, rasterizer = PinholeView(pose, 250.0, 250.0, 24.5, 24.5, 50, 50), CpuRasterizer(PluginConfig())
    after = merged(planes, 0.4, 0.2)
    assert after.shape[1] < planes.shape[1] / 7
    one, other = (rasterizer.render(each, view, differentiable=False) for each in (planes, after))
    error = ((one.color - other.color)[:, 8:42, 8:42] ** 2).mean()
    assert -10 * torch.log10(error) > 36


@pytest.mark.parametrize("sizes", [(0.0, 0.1), (-1.0, 0.1), (float("nan"), 0.1), (1.0, -0.1)])
def test_sizes_that_are_none(sizes: tuple[float, float]) -> None:
    with pytest.raises(BenchError, match="use sizes above 0"):
        merged(cloud(3), *sizes)
