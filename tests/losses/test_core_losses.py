"""The terms on depth in the C++ core against their torch form in float64, also where vectors and bands end oddly."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from loss_cases import flat_target, in_double, random_case, view_of
from torch import Tensor

from bench import _native
from bench.contracts.loss import LossTerm, LossValue, TorchLoss, runs_in_core
from bench.contracts.rasterizer import Rendered
from bench.supervision.target import Target
from plugins.losses.geo import GeoConfig, GeoLoss
from plugins.losses.normal import NormalConfig, NormalLoss
from plugins.losses.smooth import SmoothConfig, SmoothLoss

TERMS: dict[str, Callable[[], LossTerm]] = {
    "geo": lambda: GeoLoss(GeoConfig("geo")),
    "geo dense, plain": lambda: GeoLoss(GeoConfig("geo", stride=1, edge_weighted=False)),
    "geo normalized, stride 3": lambda: GeoLoss(GeoConfig("geo", stride=3, rendered_depth="normalized")),
    "geo confident": lambda: GeoLoss(GeoConfig("geo", confidence_weighted=True)),
    "geo confident, plain": lambda: GeoLoss(GeoConfig("geo", stride=3, edge_weighted=False, confidence_weighted=True)),
    "geo stride 19": lambda: GeoLoss(GeoConfig("geo", stride=19)),
    "normal": lambda: NormalLoss(NormalConfig("normal")),
    "smooth 1": lambda: SmoothLoss(SmoothConfig("smooth", distances=(1,))),
    "smooth 1, 2": lambda: SmoothLoss(SmoothConfig("smooth", distances=(1, 2))),
    "smooth 9, 2, 40": lambda: SmoothLoss(SmoothConfig("smooth", distances=(9, 2, 40))),
}
# Bands are 32 rows and vectors 8 pixels: one less, exact, and one more of each.
SIZES = [(1, 1), (1, 9), (9, 1), (2, 3), (31, 7), (32, 8), (33, 17), (64, 9), (97, 130)]


@pytest.fixture(autouse=True)
def _threads_as_before() -> Iterator[None]:
    before = _native.threads()
    yield
    _native.set_threads(before)


def _gradients(value: LossValue, like: Tensor) -> Tensor:
    """By depth and alpha, (2, H, W) float64; None is zero."""
    parts = [torch.zeros_like(like) if g is None else g for g in (value.grad_depth, value.grad_alpha)]
    return torch.stack(parts).double()


def _relative_error(got: Tensor, expected: Tensor) -> float:
    return float((got - expected).norm() / expected.norm()) if expected.any() else float(got.norm())


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("name", TERMS)
def test_core_against_torch_in_float64(name: str, size: tuple[int, int]) -> None:
    rendered, target = random_case(*size, seed=3)
    doubles = in_double(rendered, target)
    assert runs_in_core(rendered, target)
    assert not runs_in_core(*doubles)
    term = TERMS[name]()
    got, expected = term.evaluate(rendered, target), term.evaluate(*doubles)
    assert got.value == pytest.approx(expected.value, rel=1e-6)
    wanted = _gradients(expected, doubles[0].depth)
    assert _relative_error(_gradients(got, rendered.depth), wanted) <= 1e-5
    if min(size) > 2:
        assert expected.value > 0
        assert wanted.any()


@pytest.mark.parametrize("name", ["normal", "smooth 1", "smooth 1, 2"])
def test_core_is_closer_to_float64_than_torch_in_float32(name: str) -> None:
    """On smooth surfaces the differences of depth are small against the depth, and float32 in torch loses digits."""
    view = view_of(90, 121, focal=500.0)
    y, x = torch.meshgrid(torch.arange(90.0), torch.arange(121.0), indexing="ij")
    depth = 20 + 0.03 * x - 0.05 * y + 0.4 * torch.sin(0.11 * x) * torch.cos(0.07 * y)
    target = flat_target(20 + 0.02 * y + 0.3 * torch.cos(0.05 * x), view)
    rendered = Rendered(torch.zeros(3, 90, 121), depth, torch.ones(90, 121))
    term = TERMS[name]()
    assert isinstance(term, TorchLoss)
    doubles = in_double(rendered, target)
    # The target's normals come from torch in either case; give both the same ones.
    normal, valid = doubles[1].normals("points", 1)
    target._normals["points", 1] = (normal.float(), valid)
    expected = _gradients(term.evaluate(*doubles), doubles[0].depth)
    core = _relative_error(_gradients(term.evaluate(rendered, target), depth), expected)
    torch32 = _relative_error(_gradients(TorchLoss.evaluate(term, rendered, target), depth), expected)
    assert core < 1e-3
    assert core < torch32 / 3


@pytest.mark.parametrize("name", TERMS)
def test_nothing_valid(name: str) -> None:
    rendered, target = random_case(35, 21, seed=5)
    unknown = replace(target, depth=torch.zeros(35, 21), depth_mask=torch.zeros(35, 21, dtype=torch.bool))
    thin = Rendered(rendered.color, rendered.depth, rendered.alpha * 0.5)  # at most 0.5 everywhere: not covered
    for images, against in ((rendered, unknown), (thin, target)):
        if (against is unknown and name.startswith("smooth")) or (images is thin and name.startswith("geo")):
            continue  # smooth never looks at the target, geo not at the coverage
        value = TERMS[name]().evaluate(images, against)
        assert value.value == 0.0
        assert value.grad_depth is not None
        assert not value.grad_depth.any()


@pytest.mark.parametrize("name", TERMS)
def test_the_same_bits_for_any_number_of_threads(name: str) -> None:
    rendered, target = random_case(150, 67, seed=6)
    term, results = TERMS[name](), []
    for threads in (1, 2, 3):
        _native.set_threads(threads)
        results.append(term.evaluate(rendered, target))
    for other in results[1:]:
        assert other.value == results[0].value
        assert torch.equal(_gradients(other, rendered.depth), _gradients(results[0], rendered.depth))


@pytest.mark.parametrize("step", [0.0, 2.0**-21, 1e-3, 0.5, 3.0, 1e4])
def test_geo_has_the_logarithm_of_small_and_large_differences(step: float) -> None:
    """log(1 + |D - D_hat|) of one pixel, from the one ulp of a depth of 4 m up."""
    rendered = Rendered(torch.zeros(3, 1, 1), torch.full((1, 1), 4.0 + step), torch.ones(1, 1))
    difference = float(rendered.depth) - 4.0
    value = GeoLoss(GeoConfig("geo")).evaluate(rendered, flat_target(torch.full((1, 1), 4.0), view_of(1, 1)))
    assert value.value == pytest.approx(math.log1p(difference), rel=3e-7)
    assert float(value.grad_depth) == pytest.approx((difference > 0) / (1 + difference), rel=3e-7)


def _call(name: str, rendered: Rendered, target: Target, grad: Tensor) -> float:
    view = target.view
    intrinsics = (view.fx, view.fy, view.cx, view.cy)
    if name == "geo":
        return _native.geo_loss(rendered.depth, None, target.depth, target.depth_mask, None, 2, 1.0, grad, None, False)
    if name == "normal":
        return _native.normal_loss(
            rendered.depth, rendered.alpha, 0.5, *target.normals("points", 1), *intrinsics, 1.0, grad, False
        )
    return _native.smooth_loss(rendered.depth, rendered.alpha, 0.5, [1, 3], *intrinsics, 1.0, grad, False)


@pytest.mark.parametrize("width", range(1, 18))
@pytest.mark.parametrize("name", ["geo", "normal", "smooth"])
def test_every_pixel_of_the_gradient_is_written_and_nothing_beside_it(name: str, width: int) -> None:
    rendered, target = random_case(34, width, seed=7)
    around = torch.full((34 * width + 32,), float("nan"))
    _call(name, rendered, target, around[16:-16].view(34, width))
    assert torch.isfinite(around[16:-16]).all()
    assert around[:16].isnan().all()
    assert around[-16:].isnan().all()


@pytest.mark.parametrize("name", ["geo", "normal", "smooth"])
def test_images_of_different_shapes_or_types_are_refused(name: str) -> None:
    rendered, target = random_case(6, 7, seed=8)
    with pytest.raises(ValueError, match="grad_depth must have the shape of depth"):
        _call(name, rendered, target, torch.zeros(6, 8))
    with pytest.raises(TypeError, match="incompatible function arguments"):
        _call(name, rendered, target, torch.zeros(6, 7, dtype=torch.float64))
    wrong, _ = random_case(5, 7, seed=8)
    wrong.alpha = rendered.alpha
    with pytest.raises(ValueError, match=r"(alpha|target_depth) must have the shape of depth"):
        _call(name, wrong, target, torch.zeros(5, 7))


def test_targets_of_another_shape_are_refused() -> None:
    image, normals, mask = torch.ones(4, 5), torch.ones(3, 4, 5), torch.ones(4, 5, dtype=torch.bool)
    for other, valid, text in (
        (torch.ones(3, 5, 4), mask, r"target_normals must have shape \(3, H, W\)"),
        (normals, mask[:3], "target_valid must have the shape of depth"),
    ):
        with pytest.raises(ValueError, match=text):
            _native.normal_loss(image, image, 0.5, other, valid, 1.0, 1.0, 0.0, 0.0, 1.0, image.clone(), False)
    for valid, edge_weight, text in ((mask[:3], None, "depth_mask"), (mask, image[:3], "edge_weight")):
        with pytest.raises(ValueError, match=f"{text} must have the shape of depth"):
            _native.geo_loss(image, None, image, valid, edge_weight, 1, 1.0, image.clone(), None, False)


def test_settings_out_of_range_are_refused() -> None:
    image, mask = torch.ones(4, 4), torch.ones(4, 4, dtype=torch.bool)
    with pytest.raises(ValueError, match="distances must be at least 1"):
        _native.smooth_loss(image, image, 0.5, [1, 0], 1.0, 1.0, 0.0, 0.0, 1.0, image.clone(), False)
    with pytest.raises(ValueError, match="focal lengths must be positive"):
        _native.smooth_loss(image, image, 0.5, [1], 0.0, 1.0, 0.0, 0.0, 1.0, image.clone(), False)
    with pytest.raises(ValueError, match="stride must be at least 1"):
        _native.geo_loss(image, None, image, mask, None, 0, 1.0, image.clone(), None, False)
    with pytest.raises(ValueError, match="give alpha and grad_alpha, or neither"):
        _native.geo_loss(image, image, image, mask, None, 1, 1.0, image.clone(), None, False)


@pytest.mark.slow
@pytest.mark.skipif(_native.instruction_set() == "baseline", reason="these are the baseline kernels already")
def test_the_build_for_every_machine_agrees_too() -> None:
    """This file with the kernels that need no AVX2; they are chosen at load, hence the process."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", str(Path(__file__))],
        env=os.environ | {"BGS_KERNELS": "baseline"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert " passed" in done.stdout
