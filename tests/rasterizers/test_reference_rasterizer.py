"""The float64 oracle itself: hand-worked images, and its gradients against numerical differentiation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from random_scenes import SceneSpec, image_gradients, random_scene
from torch import Tensor

from bench import registry
from bench.contracts.rasterizer import Rasterizer
from bench.gaussians.parameters import planes_from
from bench.gaussians.schema import COLOR, QUATERNION
from bench.registry import PluginConfig
from bench.types import PinholeView
from plugins.rasterizers.reference import ReferenceRasterizer

F, CX, CY, W, H = 40.0, 10.0, 8.0, 21, 17
VIEW = PinholeView(np.eye(4), F, F, CX, CY, W, H)


@pytest.fixture(params=["reference", "cpu"])
def rasterizer(request: pytest.FixtureRequest) -> Rasterizer:
    built = registry.build(PluginConfig(request.param), "rasterizer")
    assert isinstance(built, Rasterizer)
    return built


def gaussian(
    mean: tuple[float, float, float],
    scales: tuple[float, float, float],
    opacity: float,
    color: tuple[float, float, float],
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
) -> Tensor:
    rows = [torch.tensor([v], dtype=torch.float32) for v in (mean, scales, quaternion)]
    return planes_from(rows[0], rows[1], rows[2], torch.tensor([opacity]), torch.tensor([color]))


def test_one_round_gaussian_worked_by_hand(rasterizer: Rasterizer) -> None:
    """At depth 4 on the optical axis: variance (40 * 0.2 / 4)^2 + 0.3 = 4.3 px^2 around the pixel (10, 8)."""
    image = rasterizer.render(gaussian((0, 0, 4), (0.2, 0.2, 0.2), 0.7, (0.9, 0.5, 0.1)), VIEW)
    y, x = np.mgrid[:H, :W]
    alpha = 0.7 * np.exp(-0.5 * ((x - 10.0) ** 2 + (y - 8.0) ** 2) / 4.3)
    alpha[alpha < 1 / 255] = 0.0
    np.testing.assert_allclose(image.alpha, alpha, atol=2e-6)
    np.testing.assert_allclose(image.depth, 4 * alpha, atol=1e-5)
    for channel, value in enumerate((0.9, 0.5, 0.1)):
        np.testing.assert_allclose(image.color[channel], value * alpha, atol=2e-6)


def test_off_axis_gaussian_is_stretched_along_x(rasterizer: Rasterizer) -> None:
    """At x = 0.8, z = 4 a ball's variance grows by 1 + (x / z)^2 = 1.04 along x only, for J = f/z [1, 0, -x/z]."""
    image = rasterizer.render(gaussian((0.8, 0, 4), (0.2, 0.2, 0.2), 0.7, (1, 1, 1)), VIEW)
    y, x = np.mgrid[:H, :W]
    alpha = 0.7 * np.exp(-0.5 * ((x - 18.0) ** 2 / (4 * 1.04 + 0.3) + (y - 8.0) ** 2 / 4.3))
    alpha[alpha < 1 / 255] = 0.0
    np.testing.assert_allclose(image.alpha, alpha, atol=2e-6)


def test_quaternion_turns_the_long_axis(rasterizer: Rasterizer) -> None:
    """30 degrees about z, w first: the covariance in pixels is R diag(4^2, 1^2) R^T + 0.3, R = [[c, -s], [s, c]]."""
    half = np.deg2rad(15.0)
    quaternion = (2 * np.cos(half), 0.0, 0.0, 2 * np.sin(half))  # any length
    image = rasterizer.render(gaussian((0, 0, 4), (0.4, 0.1, 1e-4), 0.9, (1, 1, 1), quaternion), VIEW)  # type: ignore[arg-type]
    c, s = np.cos(2 * half), np.sin(2 * half)
    R = np.array([[c, -s], [s, c]])
    conic = np.linalg.inv(R @ np.diag([16.0, 1.0]) @ R.T + 0.3 * np.eye(2))
    y, x = np.mgrid[:H, :W]
    d = np.stack([x - 10.0, y - 8.0], -1)
    alpha = 0.9 * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", d, conic, d))
    alpha[alpha < 1 / 255] = 0.0
    np.testing.assert_allclose(image.alpha, alpha, atol=5e-6)


def test_two_layers_blend_front_to_back(rasterizer: Rasterizer) -> None:
    """0.6 in front of 0.5: colour c1 0.6 + c2 0.2, depth 3 * 0.6 + 6 * 0.2, alpha 0.8, whatever the memory's order."""
    far = gaussian((0, 0, 6), (0.3, 0.3, 0.3), 0.5, (0.0, 1.0, 0.0))
    near = gaussian((0, 0, 3), (0.3, 0.3, 0.3), 0.6, (1.0, 0.0, 0.0))
    image = rasterizer.render(torch.cat([far, near], 1), VIEW)
    at = (8, 10)
    np.testing.assert_allclose([image.color[k][at] for k in range(3)], [0.6, 0.2, 0.0], atol=1e-6)
    assert float(image.depth[at]) == pytest.approx(3.0, abs=5e-6)
    assert float(image.alpha[at]) == pytest.approx(0.8, abs=1e-6)


def test_thresholds(rasterizer: Rasterizer) -> None:
    """Alpha is at most 0.999; what leaves less than 1e-4 of the light is not blended; nearer than 0.2 m is skipped."""
    wall = [gaussian((0, 0, z), (3, 3, 3), 1 - 1e-7, (1, 0, 0)) for z in (2.0, 3.0)]
    image = rasterizer.render(torch.cat(wall, 1), VIEW)
    assert float(image.alpha[8, 10]) == pytest.approx(0.999, abs=1e-6)
    assert float(image.depth[8, 10]) == pytest.approx(2 * 0.999, abs=1e-5)
    for hidden in (
        gaussian((0, 0, 0.19), (1, 1, 1), 0.9, (1, 1, 1)),
        gaussian((0, 0, 4), (1, 1, 1), 0.0039, (1, 1, 1)),
    ):
        assert float(rasterizer.render(hidden, VIEW).alpha.max()) == 0.0
    assert float(rasterizer.render(gaussian((0, 0, 4), (1, 1, 1), 0.00395, (1, 1, 1)), VIEW).alpha[8, 10]) > 0.0


def test_what_a_view_sees_worked_by_hand(rasterizer: Rasterizer) -> None:
    """A wall of opacity 0.4 at 3 m leaves 0.6, one of 0.3 at 5 m leaves 0.42: the third at 7 m is seen by no pixel."""
    walls = [gaussian((0, 0, z), (50, 50, 50), a, (1, 1, 1)) for z, a in ((7.0, 0.9), (3.0, 0.4), (5.0, 0.3))]
    # A ball in front, of 4.3 px^2: alpha >= 1/255 within 2 * 4.3 * log(0.2 * 255) = 33.8 px^2.
    ball = gaussian((0, 0, 2), (0.1, 0.1, 0.1), 0.2, (1, 1, 1))
    seen = rasterizer.observe(torch.cat([*walls, ball], 1), VIEW)
    y, x = np.mgrid[:H, :W]
    distance2 = (x - 10.0) ** 2 + (y - 8.0) ** 2
    # Where the ball covers more than 1 - 0.5 / 0.6, the first wall leaves less than a half already.
    covered = 0.2 * np.exp(-0.5 * distance2 / 4.3) > 1 - 0.5 / 0.6
    assert covered.sum() > 0
    of_ball = int((distance2 <= 2 * 4.3 * np.log(0.2 * 255)).sum())
    assert seen.pixels.tolist() == [0, W * H, W * H - covered.sum(), of_ball]
    np.testing.assert_allclose(seen.median_depth, np.where(covered, 3.0, 5.0), atol=1e-5)


def test_a_pixel_that_stays_clear_has_no_median_depth(rasterizer: Rasterizer) -> None:
    seen = rasterizer.observe(gaussian((0, 0, 4), (0.2, 0.2, 0.2), 0.7, (1, 1, 1)), VIEW)
    y, x = np.mgrid[:H, :W]
    behind_half = 0.7 * np.exp(-0.5 * ((x - 10.0) ** 2 + (y - 8.0) ** 2) / 4.3) >= 0.5
    np.testing.assert_array_equal(~seen.median_depth.isnan(), behind_half)
    assert float(seen.median_depth[8, 10]) == 4.0


def numerical(function: Callable[[Tensor], Tensor], at: Tensor, step: float) -> Tensor:
    """Central differences of a scalar function of a flat tensor."""
    out = torch.zeros_like(at)
    flat, result = at.reshape(-1), out.reshape(-1)
    for k in range(flat.numel()):
        ahead, behind = flat.clone(), flat.clone()
        ahead[k] += step
        behind[k] -= step
        result[k] = (function(ahead.view_as(at)) - function(behind.view_as(at))) / (2 * step)
    return out


@pytest.fixture(params=[0, 3])
def small_scene(request: pytest.FixtureRequest) -> tuple[Tensor, PinholeView]:
    planes, view = random_scene(SceneSpec(3, 7, 13, 9, 3.0, (0.3, 0.9), degree=request.param))
    return planes.double(), view


def test_gradients_against_numerical_differentiation(small_scene: tuple[Tensor, PinholeView]) -> None:
    planes, view = small_scene
    reference = ReferenceRasterizer(PluginConfig("reference"))
    grads = tuple(g.double() for g in image_gradients(view, 1))

    def loss(p: Tensor) -> Tensor:
        r = reference.render(p, view, differentiable=False)
        return (r.color * grads[0]).sum() + (r.depth * grads[1]).sum() + (r.alpha * grads[2]).sum()

    got = reference.backward(reference.render(planes, view), *grads).planes
    expected = numerical(loss, planes, 1e-7)
    assert float(expected.abs().max()) > 1.0
    # (In this scene no alpha lies so near to 1/255 that the step crosses it.)
    torch.testing.assert_close(got, expected, rtol=1e-5, atol=2e-6)
    assert float(got[QUATERNION].abs().max()) > 0
    assert float(got[COLOR].abs().max()) > 0


def test_twist_against_numerical_differentiation(small_scene: tuple[Tensor, PinholeView]) -> None:
    """The twist is (translation, rotation) of p_cam -> exp(twist) p_cam; torch's matrix exponential is the truth."""
    planes, view = small_scene
    reference = ReferenceRasterizer(PluginConfig("reference"))
    grads = tuple(g.double() for g in image_gradients(view, 2))

    def loss(twist: Tensor) -> Tensor:
        rho, (a, b, c) = twist[:3], twist[3:].tolist()
        generator = torch.zeros(4, 4, dtype=torch.float64)
        generator[:3, :3] = torch.tensor([[0, -c, b], [c, 0, -a], [-b, a, 0]], dtype=torch.float64)
        generator[:3, 3] = rho
        moved = torch.matrix_exp(generator).numpy() @ view.T_cam_world
        turned = PinholeView(np.linalg.inv(moved), view.fx, view.fy, view.cx, view.cy, view.width, view.height)
        r = reference.render(planes, turned, differentiable=False)
        return (r.color * grads[0]).sum() + (r.depth * grads[1]).sum() + (r.alpha * grads[2]).sum()

    got = reference.backward(reference.render(planes, view), *grads, pose=True).twist
    assert got is not None
    torch.testing.assert_close(got, numerical(loss, torch.zeros(6, dtype=torch.float64), 1e-7), rtol=1e-5, atol=1e-5)


def test_images_and_gradients_come_in_the_dtype_of_the_parameters(small_scene: tuple[Tensor, PinholeView]) -> None:
    """The contract says float32; float64 parameters (an oracle's use) keep their precision."""
    planes, view = small_scene
    reference = ReferenceRasterizer(PluginConfig("reference"))
    for dtype in (torch.float32, torch.float64):
        rendered = reference.render(planes.to(dtype), view)
        assert {rendered.color.dtype, rendered.depth.dtype, rendered.alpha.dtype} == {dtype}
        grads = tuple(g.to(dtype) for g in image_gradients(view, 1))
        assert reference.backward(rendered, *grads).planes.dtype == dtype
