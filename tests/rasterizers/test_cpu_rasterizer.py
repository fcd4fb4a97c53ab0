"""The C++ core against the float64 reference: images, gradients of every group, pose, and odd sizes and numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from random_scenes import GROUPS, SceneSpec, image_gradients, random_scene, relative_l2, render_and_back
from torch import Tensor

from bench import _native
from bench.contracts.rasterizer import Rasterizer, Rendered
from bench.gaussians.parameters import planes_from
from bench.gaussians.schema import planes_of
from bench.registry import PluginConfig
from bench.types import PinholeView
from plugins.rasterizers.cpu import CpuRasterizer
from plugins.rasterizers.reference import ReferenceRasterizer

SCENES = {
    "round, transparent, 70x41": SceneSpec(1, 203, 70, 41, 1.2, (0.05, 0.5)),
    "round, opaque, 33x17": SceneSpec(2, 61, 33, 17, 1.2, (0.6, 0.99)),
    "long, transparent, 33x17": SceneSpec(3, 64, 33, 17, 6.0, (0.05, 0.5)),
    "long, opaque, 70x41": SceneSpec(4, 150, 70, 41, 6.0, (0.6, 0.99)),
    "long, mixed, several tiles": SceneSpec(5, 321, 97, 50, 6.0, (0.01, 0.99)),
    "one pixel wide": SceneSpec(6, 30, 1, 19, 2.0, (0.2, 0.8)),
    "one tile exactly": SceneSpec(7, 80, 32, 16, 3.0, (0.2, 0.8)),
    "one Gaussian": SceneSpec(8, 2, 40, 30, 3.0, (0.5, 0.6)),
    "harmonics of degree 1": SceneSpec(11, 203, 70, 41, 3.0, (0.05, 0.9), degree=1),
    "harmonics of degree 2": SceneSpec(12, 150, 33, 17, 3.0, (0.05, 0.9), degree=2),
    "harmonics of degree 3": SceneSpec(13, 321, 97, 50, 3.0, (0.05, 0.9), degree=3),
}


@pytest.fixture(autouse=True)
def _threads_as_before() -> Iterator[None]:
    before = _native.threads()
    yield
    _native.set_threads(before)


def cpu(threads: int = 1) -> CpuRasterizer:
    _native.set_threads(threads)
    return CpuRasterizer(PluginConfig("cpu"))


def reference() -> ReferenceRasterizer:
    return ReferenceRasterizer(PluginConfig("reference"))


@pytest.mark.parametrize("name", SCENES)
def test_images_agree_with_the_reference(name: str) -> None:
    planes, view = random_scene(SCENES[name])
    fast, truth = cpu().render(planes, view), reference().render(planes.double(), view)
    assert float(truth.alpha.max()) > 0.05  # something is there
    for mine, true in ((fast.color, truth.color), (fast.depth, truth.depth), (fast.alpha, truth.alpha)):
        error = ((mine.double() - true).abs() / true.abs().clamp_min(1.0)).flatten()
        assert float(error.quantile(0.999)) < 1e-5
        # A float32 alpha may fall on the other side of 1/255: one step of 1/255 of a colour, or of a depth of 9 m.
        assert float(error.max()) < 5e-3


@pytest.mark.parametrize("name", SCENES)
def test_gradients_agree_with_the_reference(name: str) -> None:
    planes, view = random_scene(SCENES[name])
    grads = image_gradients(view, 7)
    _, mine = render_and_back(cpu(), planes, view, grads)
    _, true = render_and_back(reference(), planes.double(), view, tuple(g.double() for g in grads))  # type: ignore[arg-type]
    for group, rows in GROUPS.items():
        assert relative_l2(mine.planes[rows], true.planes[rows]) <= 1e-5, group
    assert mine.twist is not None
    assert true.twist is not None
    assert relative_l2(mine.twist, true.twist) <= 5e-5
    # Touched Gaussians are at least those that any pixel shows.
    assert bool((mine.touched | ~true.touched).all())


@pytest.mark.parametrize("only", ["color", "depth", "alpha"])
def test_each_image_alone_and_missing_gradients(only: str) -> None:
    """None for an image's gradient means zero."""
    planes, view = random_scene(SCENES["long, opaque, 70x41"])
    at = ("color", "depth", "alpha").index(only)
    given = [g if k == at else None for k, g in enumerate(image_gradients(view, 3))]
    one, other = cpu(), reference()
    mine = one.backward(one.render(planes, view), *given, pose=True)
    true = other.backward(other.render(planes.double(), view), *given, pose=True)
    for group, rows in GROUPS.items():
        if only != "color" and group in ("colors", "harmonics"):
            assert float(mine.dense()[rows].abs().sum()) == 0.0
        else:
            assert relative_l2(mine.dense()[rows], true.planes[rows]) <= 1e-5, group
    assert relative_l2(mine.twist, true.twist) <= 5e-5  # type: ignore[arg-type]


@pytest.mark.parametrize("make", [cpu, reference])
def test_no_image_gradient_at_all(make: Callable[[], Rasterizer]) -> None:
    planes, view = random_scene(SCENES["one tile exactly"])
    rasterizer = make()
    result = rasterizer.backward(rasterizer.render(planes, view), None, None, None, pose=True)
    assert float(result.dense().abs().sum()) == 0.0
    assert result.twist is not None
    assert result.twist.tolist() == [0.0] * 6


@pytest.mark.parametrize("make", [cpu, reference])
@pytest.mark.parametrize("behind", [False, True])
def test_nothing_to_see(make: Callable[[], Rasterizer], behind: bool) -> None:
    """No Gaussian at all, or one behind the camera: black images and zero gradients of the right shapes."""
    _, view = random_scene(SCENES["round, opaque, 33x17"])
    planes = torch.zeros(planes_of(0), int(behind))
    if behind:
        planes[:3, 0] = torch.from_numpy(view.T_world_cam @ [0.1, 0.1, -3.0, 1.0])[:3].float()
        planes[6] = 1.0
    rendered, grads = render_and_back(make(), planes, view, image_gradients(view, 1))
    assert rendered.color.shape == (3, 17, 33)
    for image in (rendered.color, rendered.depth, rendered.alpha):
        assert float(image.abs().max()) == 0.0
    assert grads.planes.shape == planes.shape
    assert float(grads.planes.abs().sum()) == 0.0
    assert not grads.touched.any()
    assert grads.twist is not None
    assert grads.twist.tolist() == [0.0] * 6


@pytest.mark.parametrize("count", [1, 7, 8, 9, 2047, 2048, 2049])
def test_counts_around_a_vector_and_around_a_chunk(count: int) -> None:
    """Rendering the first ``count`` of many Gaussians is the same as hiding the others."""
    planes, view = random_scene(SceneSpec(9, 2049, 33, 17, 2.0, (0.02, 0.3)))
    hidden = planes.clone()
    hidden[10, count:] = -20.0
    grads = image_gradients(view, 5)
    few, few_grads = render_and_back(cpu(), planes[:, :count].contiguous(), view, grads)
    all_, all_grads = render_and_back(cpu(), hidden, view, grads)
    assert torch.equal(few.color, all_.color)
    assert torch.equal(few_grads.planes, all_grads.planes[:, :count])


def _around(view: PinholeView, seed: int, away_m: float) -> tuple[Tensor, PinholeView]:
    """Gaussians in front, behind, beside and astride the borders, from dots to giants and needles; a moved view."""
    rng = np.random.default_rng(seed)
    n = 600
    z = rng.normal(0.0, 6.0, n)
    slope = rng.normal(0.0, 1.5, (2, n)) * [[view.width / view.fx], [view.height / view.fy]]
    sizes = np.exp(rng.normal(-2.0, 2.0, n) + rng.normal(0.0, 1.5, (3, n)))
    opacities = rng.uniform(0.001, 0.999, n)
    turns, colors = rng.normal(size=(4, n)), rng.normal(size=(3, n))
    planes = np.concatenate(
        [slope * z, z[None], np.log(sizes), turns, np.log(opacities / (1 - opacities))[None], colors]
    )
    T_world_cam = np.eye(4)
    T_world_cam[:3, 3] = away_m
    planes[:3] += away_m
    return torch.from_numpy(planes.astype(np.float32)), replace(view, T_world_cam=T_world_cam)


@pytest.mark.parametrize("make", [cpu, reference])
@pytest.mark.parametrize("pose", [False, True])
def test_gradients_of_those_that_learn_are_the_first_of_all(make: Callable[[], Rasterizer], pose: bool) -> None:
    planes, view = random_scene(SCENES["one tile exactly"])
    grads, rasterizer = image_gradients(view, 2), make()
    _, whole = render_and_back(rasterizer, planes, view, grads, pose)
    for learning in (0, 1, 8, 37, planes.shape[1]):
        some = rasterizer.backward(rasterizer.render(planes, view), *grads, pose=pose, learning=learning)
        assert torch.equal(some.dense(), whole.planes[:, :learning])
        assert torch.equal(some.touched, whole.touched[:learning])
        assert (some.twist is None) == (whole.twist is None)
        if some.twist is not None:
            assert torch.equal(some.twist, whole.twist)  # type: ignore[arg-type]


@pytest.mark.parametrize("strange", [False, True])
@pytest.mark.parametrize("away_m", [0.0, 8000.0])
@pytest.mark.parametrize("seed", range(4))
def test_leaving_out_what_lies_outside_the_view_changes_no_bit(seed: int, away_m: float, strange: bool) -> None:
    """Groups of eight are left out whole. Here each is one Gaussian and seven invisible copies; then, by another order
    of the same map, each has a neighbour in view, so that none is left out."""
    few, view = random_scene(SceneSpec(seed, 600, 70, 41, 2.0, (0.1, 0.9)))
    planes, view = _around(view, seed, away_m)
    if strange:
        hit = torch.rand(planes.shape, generator=torch.Generator().manual_seed(seed)) < 0.03
        extremes = torch.tensor([torch.nan, torch.inf, -torch.inf, 3e38, -3e38, 1e30, -1e30, 80.0, -80.0, 0.0])
        planes[hit] = extremes.repeat(len(planes) * planes.shape[1])[: int(hit.sum())]
    copies = planes.repeat_interleave(8, 1)
    copies[10] = torch.where(torch.arange(copies.shape[1]) % 8 == 0, copies[10], -20.0)
    few[:3], few[3:6] = torch.tensor([[0.0], [0.0], [5.0]]) + away_m, -5.0
    apart, order = torch.cat([copies, few], 1), torch.arange(copies.shape[1] + few.shape[1])
    neighbours = torch.arange(7, copies.shape[1], 8)
    order[neighbours], order[copies.shape[1] :] = order[copies.shape[1] :].clone(), neighbours
    grads = image_gradients(view, seed)
    (rendered, gradients), (all_, by_all) = (
        render_and_back(cpu(), each, view, grads) for each in (apart, apart[:, order])
    )
    assert torch.equal(gradients.touched[order], by_all.touched)
    assert 0 < int(gradients.touched[: copies.shape[1] : 8].sum()) < 500
    if not strange:
        assert torch.equal(rendered.color, all_.color)
        assert torch.equal(gradients.planes[:, order], by_all.planes)


def test_scratch_memory_goes_by_what_is_in_view() -> None:
    planes, view = random_scene(SCENES["one tile exactly"])
    behind = planes[:, ::11].repeat(1, 10_000)
    rasterizer = cpu()
    workspaces = [rasterizer.render(each, view).context[0] for each in (planes, torch.cat([behind, planes], 1))]
    assert workspaces[0].visible == workspaces[1].visible > 0
    assert workspaces[1].bytes - workspaces[0].bytes < 5 * behind.shape[1]


@pytest.mark.parametrize("make", [cpu, reference])
@pytest.mark.parametrize("spare", [1, 8, 1000])
def test_the_front_of_a_larger_buffer_is_as_good_as_a_copy(make: Callable[[], Rasterizer], spare: int) -> None:
    planes, view = random_scene(SCENES["round, opaque, 33x17"])
    count, grads = planes.shape[1], image_gradients(view, 5)
    buffer = torch.full((len(planes), count + spare), torch.nan)
    front = buffer[:, :count]
    front[:] = planes
    (copied, by_copied), (rendered, by_front) = (render_and_back(make(), each, view, grads) for each in (planes, front))
    assert torch.equal(rendered.color, copied.color)
    assert torch.equal(by_front.planes, by_copied.planes)
    assert torch.equal(by_front.twist, by_copied.twist)  # type: ignore[arg-type]
    assert torch.equal(make().observe(front, view).pixels, make().observe(planes, view).pixels)
    assert make().render(buffer[:, :0], view).alpha.max() == 0.0


def test_same_bits_for_any_number_of_threads() -> None:
    planes, view = random_scene(SceneSpec(10, 5000, 150, 70, 4.0, (0.02, 0.95)))
    grads = image_gradients(view, 6)
    results = [render_and_back(cpu(threads), planes, view, grads) for threads in (1, 2, 3)]
    assert _native.threads() == 3
    for rendered, gradients in results[1:]:
        for name in ("color", "depth", "alpha"):
            assert torch.equal(getattr(rendered, name), getattr(results[0][0], name)), name
        assert torch.equal(gradients.planes, results[0][1].planes)
        assert torch.equal(gradients.twist, results[0][1].twist)  # type: ignore[arg-type]
        assert torch.equal(gradients.touched, results[0][1].touched)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_harmonics_of_coefficient_zero_change_nothing(degree: int) -> None:
    planes, view = random_scene(SCENES["long, opaque, 70x41"])
    grads = image_gradients(view, 5)
    plain, by_plain = render_and_back(cpu(), planes, view, grads)
    wide = torch.cat([planes, torch.zeros(planes_of(degree) - len(planes), planes.shape[1])])
    rendered, by_wide = render_and_back(cpu(), wide, view, grads)
    assert torch.equal(rendered.color, plain.color)
    assert torch.equal(by_wide.planes[: len(planes)], by_plain.planes)
    assert torch.equal(by_wide.twist, by_plain.twist)  # type: ignore[arg-type]
    assert float(by_wide.planes[len(planes) :].abs().max()) > 0.0


@pytest.mark.parametrize("name", SCENES)
def test_what_a_view_sees_agrees_with_the_reference(name: str) -> None:
    planes, view = random_scene(SCENES[name])
    mine, true = cpu().observe(planes, view), reference().observe(planes.double(), view)
    assert mine.pixels.dtype == torch.int32
    assert mine.median_depth.dtype == torch.float32
    # As for images, an alpha may fall on the other side of 1/255, or a transmittance on the other side of a half.
    assert int((mine.pixels - true.pixels).abs().sum()) <= 2e-4 * int(true.pixels.sum())
    assert torch.equal(mine.median_depth.isnan(), true.median_depth.isnan())
    error = (mine.median_depth - true.median_depth).abs().nan_to_num()
    assert float((error > 1e-4).double().mean()) <= 1e-3


def test_same_observation_for_any_number_of_threads_and_after_a_render() -> None:
    planes, view = random_scene(SceneSpec(10, 5000, 150, 70, 4.0, (0.02, 0.95)))
    results = []
    for threads in (1, 2, 3):
        rasterizer = cpu(threads)
        results.append(rasterizer.observe(planes, view))
        rendered = rasterizer.render(planes, view)
        results.append(rasterizer.observe(planes, view))
        rasterizer.backward(rendered, *image_gradients(view, 1))
    for other in results[1:]:
        assert torch.equal(other.pixels, results[0].pixels)
        assert torch.equal(other.median_depth.nan_to_num(-1.0), results[0].median_depth.nan_to_num(-1.0))


def test_two_renders_before_the_first_backward() -> None:
    planes, view = random_scene(SCENES["long, opaque, 70x41"])
    other_planes, other_view = random_scene(SCENES["round, opaque, 33x17"])
    grads, other_grads = image_gradients(view, 1), image_gradients(other_view, 2)
    alone = render_and_back(cpu(), planes, view, grads)[1]
    other_alone = render_and_back(cpu(), other_planes, other_view, other_grads)[1]
    rasterizer = cpu()
    first = rasterizer.render(planes, view)
    second = rasterizer.render(other_planes, other_view)
    rasterizer.render(other_planes, other_view, differentiable=False)
    assert torch.equal(rasterizer.backward(first, *grads, pose=True).dense(), alone.planes)
    assert torch.equal(rasterizer.backward(second, *other_grads, pose=True).dense(), other_alone.planes)


@pytest.mark.parametrize("length_m", [0.5, 7.4, 50.0, 1000.0])
@pytest.mark.parametrize("turn", [0.3, np.pi / 4, 1.2])
def test_a_needle_across_the_image_is_no_more_opaque_than_it_is(length_m: float, turn: float) -> None:
    """The determinant of its covariance is the 1e-12th part of the products that it is the difference of."""
    view = PinholeView(np.eye(4), 707.0, 707.0, 200.0, 60.0, 400, 120)
    planes = planes_from(
        torch.tensor([[0.1, -0.2, 5.0]]),
        torch.tensor([[0.002, length_m, 0.00036]]),
        torch.tensor([[np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)]]).float(),
        torch.tensor([0.3]),
        torch.tensor([[0.2, 0.5, 0.9]]),
    )
    found, true = cpu().render(planes, view), reference().render(planes.double(), view)
    assert true.alpha.max() > 0.29
    torch.testing.assert_close(found.alpha.double(), true.alpha, rtol=0, atol=0.01)
    torch.testing.assert_close(found.color.double(), true.color, rtol=0, atol=0.01)


def test_images_may_be_let_go_before_the_backward_pass() -> None:
    """The backward pass reads them again; what then lies in their memory must not count."""
    planes, view = random_scene(SCENES["long, opaque, 70x41"])
    grads = image_gradients(view, 1)
    alone = render_and_back(cpu(), planes, view, grads)[1]
    rasterizer = cpu()
    context = rasterizer.render(planes, view).context
    others = [torch.full(shape, torch.nan) for shape in ((3, 41, 70), (41, 70)) for _ in range(8)]
    gone = Rendered(others[0], others[-1], others[-2], context)
    assert torch.equal(rasterizer.backward(gone, *grads).dense(), alone.planes)


def test_far_away_huge_and_tiny_gaussians_stay_finite() -> None:
    """Extremes that optimisation can reach: no NaN, no infinity in images or gradients."""
    planes, view = random_scene(SCENES["round, transparent, 70x41"])
    planes[3:6, 0] = 8.0  # standard deviation of 3 km
    planes[3:6, 1] = -20.0
    planes[10, 2], planes[10, 3] = 40.0, -40.0
    planes[6:10, 4] = 0.0  # a quaternion of length zero
    planes[:3, 5] *= 1e4
    planes[11:14, 6] = 50.0
    rendered, grads = render_and_back(cpu(), planes, view, image_gradients(view, 4))
    for values in (rendered.color, rendered.depth, rendered.alpha, grads.planes, grads.twist):
        assert bool(torch.isfinite(values).all())  # type: ignore[arg-type]


def _bad(change: str, planes: Tensor) -> Tensor:
    return {
        "rows": planes[:13].contiguous(),
        "dtype": planes.double(),
        "transposed": planes.T.contiguous().T,
        "one row for all": planes[:1].expand(14, -1),
        "one dimension": planes.flatten(),
    }[change]


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ("rows", ValueError, r"planes must have shape \(14, N\), \(23, N\)"),
        ("dtype", TypeError, r"planes: .*float32"),
        ("transposed", ValueError, "planes: each row must be contiguous"),
        ("one row for all", ValueError, "planes: each row must be contiguous and the rows must not overlap"),
        ("one dimension", TypeError, r"planes: "),
    ],
)
def test_wrong_parameters_are_refused(change: str, error: type[Exception], text: str) -> None:
    planes, view = random_scene(SCENES["one tile exactly"])
    with pytest.raises(error, match=text):
        cpu().render(_bad(change, planes), view)


def test_wrong_gradient_images_are_refused() -> None:
    planes, view = random_scene(SCENES["one tile exactly"])
    rasterizer = cpu()
    color, depth, alpha = image_gradients(view, 1)
    for bad, text in (
        ((color[:, 1:].contiguous(), depth, alpha), r"grad_color must have shape \(3, H, W\)"),
        ((color, depth[1:].contiguous(), alpha), r"grad_depth must have shape \(H, W\)"),
        ((color, depth, alpha[:, 1:].contiguous()), r"grad_alpha must have shape \(H, W\)"),
    ):
        with pytest.raises(ValueError, match=text):
            rasterizer.backward(rasterizer.render(planes, view), *bad)


def test_views_that_make_no_sense_are_refused() -> None:
    planes, view = random_scene(SCENES["one tile exactly"])
    with pytest.raises(ValueError, match="focal lengths must be positive"):
        cpu().render(planes, PinholeView(view.T_world_cam, 0.0, 10.0, 5.0, 5.0, 10, 10))
    with pytest.raises(ValueError, match="image size must be between 1 and 32000"):
        cpu().render(planes, PinholeView(view.T_world_cam, 10.0, 10.0, 5.0, 5.0, 0, 10))
