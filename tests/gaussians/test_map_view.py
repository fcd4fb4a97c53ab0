"""What a tracker may ask of a Gaussian map, against finite differences and a scene worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from torch import Tensor

from bench.authoring.random_scenes import SceneSpec, random_scene
from bench.errors import BenchError
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.gaussians.parameters import planes_from
from bench.registry import PluginConfig
from bench.types import Float, PinholeView
from plugins.rasterizers.cpu import CpuRasterizer
from plugins.rasterizers.reference import ReferenceRasterizer


def map_of(planes: Tensor) -> GaussianMap:
    made = GaussianMap(0, torch.device("cpu"))
    made.add(0, np.eye(4), planes, torch.ones(planes.shape[1]))
    return made


def moved(view: PinholeView, twist: Float) -> PinholeView:
    """The view whose camera coordinates are exp(twist) times those of ``view``, by scipy's matrix exponential."""
    (x, y, z), (a, b, c) = twist[:3], twist[3:]
    generator = np.array([[0, -c, b, x], [c, 0, -a, y], [-b, a, 0, z], [0, 0, 0, 0]])
    T_world_cam = np.linalg.inv(expm(generator) @ view.T_cam_world)
    return PinholeView(T_world_cam, view.fx, view.fy, view.cx, view.cy, view.width, view.height)


def test_gradient_by_the_twist_against_finite_differences() -> None:
    planes, view = random_scene(SceneSpec(1, 60, 48, 30, 2.0, (0.1, 0.9)))
    weight = torch.rand(30, 48, generator=torch.Generator().manual_seed(0))

    def loss(color: Tensor, depth: Tensor, alpha: Tensor) -> Tensor:
        return (weight * (color**2).sum(0)).mean() + 0.1 * (weight * depth).mean() + (alpha**3).mean()

    value, gradient = GaussianMapView(map_of(planes), CpuRasterizer(PluginConfig("cpu"))).differentiate(view, loss)
    exact, step = ReferenceRasterizer(PluginConfig("reference")), 1e-7

    def at(twist: Float) -> float:
        rendered = exact.render(planes.double(), moved(view, twist), differentiable=False)
        return float(loss(rendered.color, rendered.depth, rendered.alpha))

    differences = [(at(step * axis) - at(-step * axis)) / (2 * step) for axis in np.eye(6)]
    assert value == pytest.approx(at(np.zeros(6)), rel=1e-4)
    assert gradient.shape == (6,)
    np.testing.assert_allclose(gradient, differences, rtol=2e-3, atol=2e-3 * np.abs(differences).max())


def test_a_loss_of_one_image_alone_and_one_of_none() -> None:
    planes, view = random_scene(SceneSpec(1, 60, 48, 30, 2.0, (0.1, 0.9)))
    sight = GaussianMapView(map_of(planes), CpuRasterizer(PluginConfig("cpu")))
    value, gradient = sight.differentiate(view, lambda color, depth, alpha: alpha.sum())
    assert value == pytest.approx(float(sight.render(view).alpha.sum()), rel=1e-5)
    assert np.abs(gradient).max() > 0
    with pytest.raises(BenchError, match="does not depend on colour"):
        sight.differentiate(view, lambda color, depth, alpha: torch.zeros(()))


def test_an_empty_map_shows_nothing() -> None:
    view = PinholeView(np.eye(4), 30.0, 30.0, 9.5, 7.5, 20, 16)
    sight = GaussianMapView(map_of(torch.zeros(14, 0)), CpuRasterizer(PluginConfig("cpu")))
    assert not sight.render(view).alpha.any()
    value, gradient = sight.differentiate(view, lambda color, depth, alpha: (1 - alpha).sum())
    assert value == 20 * 16
    np.testing.assert_array_equal(gradient, np.zeros(6))
    assert sight.seen(view).shape == (0,)
    assert np.isnan(sight.median_depth(view)).all()


def test_what_is_seen_and_how_far() -> None:
    """Three discs behind each other in the middle of the image: thin at 2 m, opaque at 4 m, and hidden at 6 m."""
    view = PinholeView(np.eye(4), 30.0, 30.0, 9.5, 7.5, 20, 16)
    sight = GaussianMapView(
        map_of(
            planes_from(
                torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, 4.0], [0.0, 0.0, 6.0], [0.0, 0.0, -5.0]]),
                torch.full((4, 3), 0.2),
                torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(4, 1),
                torch.tensor([0.3, 0.95, 0.9, 0.9]),
                torch.full((4, 3), 0.5),
            )
        ),
        CpuRasterizer(PluginConfig("cpu")),
    )
    seen, median = sight.seen(view), sight.median_depth(view)
    assert seen[0] > seen[1] > seen[2] > 0 == seen[3]
    assert median[7, 9] == pytest.approx(4.0)
    assert np.isnan(median[0, 0])
