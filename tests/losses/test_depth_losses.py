"""geo, normal and smooth: hand-worked cases in the paper's form, and gradients against numerical differentiation."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from loss_cases import flat_target, in_double, random_case, view_of
from torch import Tensor

from bench.contracts.loss import CoreLoss, LossTerm
from bench.contracts.rasterizer import Rendered
from bench.errors import BenchError
from bench.geometry.normals import normals_from_depth
from bench.supervision.target import Target
from bench.types import PinholeView
from plugins.losses.geo import GeoConfig, GeoLoss
from plugins.losses.normal import NormalConfig, NormalLoss
from plugins.losses.smooth import SmoothConfig, SmoothLoss


def two_by_two() -> tuple[Rendered, Target]:
    """Stereo depth 4, 5, unknown, 8 m; rendered 5, 5, 3, 6 m; alpha 1, 0.5, 0.5, 0.75."""
    depth = torch.tensor([[4.0, 5.0], [0.0, 8.0]])
    mask = torch.tensor([[True, True], [False, True]])
    rendered = Rendered(
        torch.zeros(3, 2, 2), torch.tensor([[5.0, 5.0], [3.0, 6.0]]), torch.tensor([[1.0, 0.5], [0.5, 0.75]])
    )
    return rendered, flat_target(depth, view_of(2, 2), mask)


def test_geo_by_hand_raw() -> None:
    """A flat image has g = 1. |D - D_hat| = 1, 0, (masked), 2: the mean over all four is (log 2 + 0 + 0 + log 3) / 4.

    d/dD = sign / (1 + |difference|) / 4 = 1/8, 0, 0, -1/12.
    """
    rendered, target = two_by_two()
    value = GeoLoss(GeoConfig("geo", stride=1)).evaluate(rendered, target)
    assert value.value == pytest.approx((np.log(2) + np.log(3)) / 4, rel=1e-6)
    torch.testing.assert_close(value.grad_depth, torch.tensor([[1 / 8, 0.0], [0.0, -1 / 12]]))
    assert value.grad_alpha is None
    assert value.grad_color is None


def test_geo_by_hand_normalized() -> None:
    """D / alpha = 5, 10, 6, 8: differences 1, 5, (masked), 0."""
    rendered, target = two_by_two()
    value = GeoLoss(GeoConfig("geo", stride=1, rendered_depth="normalized")).evaluate(rendered, target)
    assert value.value == pytest.approx((np.log(2) + np.log(6)) / 4, rel=1e-6)
    # By depth: 1/2/4 / 1 and 1/6/4 / 0.5; by alpha: -(1/8) 5 / 1 and -(1/24) 10 / 0.5.
    torch.testing.assert_close(value.grad_depth, torch.tensor([[1 / 8, 1 / 12], [0.0, 0.0]]))
    torch.testing.assert_close(value.grad_alpha, torch.tensor([[-5 / 8, -10 / 12], [0.0, 0.0]]))


def test_geo_samples_every_other_pixel() -> None:
    """Stride 2 of a 3x4 image keeps rows 0, 2 and columns 0, 2: a mean over 4 pixels; the others get no gradient."""
    depth = torch.full((3, 4), 5.0)
    shown = depth + torch.arange(12.0).view(3, 4)
    rendered = Rendered(torch.zeros(3, 3, 4), shown, torch.ones(3, 4))
    value = GeoLoss(GeoConfig("geo", stride=2)).evaluate(rendered, flat_target(depth, view_of(3, 4)))
    assert value.value == pytest.approx((np.log(1) + np.log(3) + np.log(9) + np.log(11)) / 4, rel=1e-6)
    assert value.grad_depth is not None
    assert sorted(map(tuple, value.grad_depth.nonzero().tolist())) == [(0, 2), (2, 0), (2, 2)]


def test_geo_edge_weight_by_hand() -> None:
    """g = exp(-|grad I|) with central differences of the grey image: here columns 0, 0.4, 1 in all channels."""
    column = torch.tensor([0.0, 0.4, 1.0])
    view = view_of(3, 3)
    ones = torch.ones(3, 3, dtype=torch.bool)
    target = Target(column.expand(3, 3, 3).contiguous(), torch.full((3, 3), 4.0), ones, view)
    expected = torch.ones(3, 3)
    expected[:, 1] = np.exp(-0.5)  # (1 - 0) / 2; the first and last column have no two neighbours
    torch.testing.assert_close(target.edge_weight, expected)
    rendered = Rendered(torch.zeros(3, 3, 3), torch.full((3, 3), 5.0), torch.ones(3, 3))
    weighted = GeoLoss(GeoConfig("geo", stride=1)).evaluate(rendered, target).value
    plain = GeoLoss(GeoConfig("geo", stride=1, edge_weighted=False)).evaluate(rendered, target).value
    assert weighted == pytest.approx(np.log(2) * (6 + 3 * np.exp(-0.5)) / 9, rel=1e-6)
    assert plain == pytest.approx(np.log(2), rel=1e-6)


def test_geo_confidence_by_hand() -> None:
    """The terms of the raw case, log 2, 0, (masked) and log 3, times confidences 1, 0.3, 0.2 and 0.5."""
    rendered, target = two_by_two()
    confident = GeoLoss(GeoConfig("geo", stride=1, confidence_weighted=True))
    with pytest.raises(BenchError, match="the stereo plugin gives no confidence"):
        confident.evaluate(rendered, target)
    target = replace(target, confidence=torch.tensor([[1.0, 0.3], [0.2, 0.5]]))
    value = confident.evaluate(rendered, target)
    assert value.value == pytest.approx((np.log(2) + 0.5 * np.log(3)) / 4, rel=1e-6)
    torch.testing.assert_close(value.grad_depth, torch.tensor([[1 / 8, 0.0], [0.0, -1 / 24]]))
    _, noise = random_case(5, 6, seed=1)
    torch.testing.assert_close(noise.confident_edge_weight, noise.edge_weight * noise.confidence)
    assert noise.halved().confidence is not None
    torch.testing.assert_close(noise.halved().confidence, noise.confidence[0:4:2, 0:6:2])


def test_edge_weight_of_a_diagonal_ramp() -> None:
    """I = 0.1 x + 0.2 y: |grad| = sqrt(0.05) inside the image."""
    y, x = torch.meshgrid(torch.arange(5.0), torch.arange(4.0), indexing="ij")
    ramp = (0.1 * x + 0.2 * y).expand(3, 5, 4).contiguous()
    mask = torch.ones(5, 4, dtype=torch.bool)
    weight = Target(ramp, torch.ones(5, 4), mask, view_of(5, 4)).edge_weight
    torch.testing.assert_close(weight[1:-1, 1:-1], torch.full((3, 2), float(np.exp(-np.sqrt(0.05)))))


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"stride": 0}, "loss.geo.stride=0 must be at least 1"),
        ({"rendered_depth": "normalised"}, "loss.geo.rendered_depth='normalised'.*Did you mean 'normalized'"),
    ],
)
def test_geo_refuses_wrong_settings(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(BenchError, match=text):
        GeoConfig("geo", **settings)


def test_smooth_refuses_wrong_distances() -> None:
    with pytest.raises(BenchError, match=r"loss.smooth.distances=\[0\] must hold positive"):
        SmoothConfig("smooth", distances=(0,))


def plane_depth(view: PinholeView, normal: tuple[float, float, float], distance: float) -> Tensor:
    """Depth of the plane n . p = distance: z = distance / (n . (x, y, 1)), float64."""
    x = (torch.arange(view.width, dtype=torch.float64) - view.cx) / view.fx
    y = (torch.arange(view.height, dtype=torch.float64) - view.cy) / view.fy
    return distance / (normal[0] * x[None, :] + normal[1] * y[:, None] + normal[2])


@pytest.mark.parametrize("toward", [(0.0, 0.0, 1.0), (0.36, 0.48, 0.8), (0.0, 0.8, 0.6), (-0.6, 0.0, 0.8)])
@pytest.mark.parametrize("step", [1, 3])
def test_normals_of_a_plane(toward: tuple[float, float, float], step: int) -> None:
    """The plane n . p = 6 seen from its near side: the normal that faces the camera is -n, everywhere."""
    view = view_of(12, 15, focal=40.0)
    depth = plane_depth(view, toward, 6.0)
    assert float(depth.min()) > 0
    normal, valid = normals_from_depth(depth, torch.ones_like(depth, dtype=torch.bool), view, step=step)
    assert valid[:-step, :-step].all()
    assert not valid[-step:].any()
    assert not valid[:, -step:].any()
    expected = -torch.tensor(toward, dtype=torch.float64)[:, None, None].expand(3, 12 - step, 15 - step)
    torch.testing.assert_close(normal[:, :-step, :-step], expected, atol=1e-9, rtol=0)


@pytest.mark.parametrize("step", [1, 2])
def test_slopes_are_those_of_the_depth_image(step: int) -> None:
    """z = 3 + 0.75 u has the slopes (-0.75, 0, 1), of length 1.25, whatever the camera."""
    depth = 3 + 0.75 * torch.arange(6, dtype=torch.float64).expand(5, 6)
    normal, valid = normals_from_depth(depth, torch.ones(5, 6, dtype=torch.bool), view_of(5, 6), "slopes", step)
    assert int(valid.sum()) == (5 - step) * (6 - step)
    torch.testing.assert_close(
        normal[:, valid].T, torch.tensor([[-0.6, 0.0, 0.8]]).double().expand(int(valid.sum()), 3)
    )


def test_images_smaller_than_the_step_have_no_normals() -> None:
    normal, valid = normals_from_depth(torch.ones(3, 9), torch.ones(3, 9, dtype=torch.bool), view_of(3, 9), step=3)
    assert normal.shape == (3, 3, 9)
    assert not valid.any()


def test_normals_need_the_right_and_the_lower_neighbour() -> None:
    known = torch.ones(4, 4, dtype=torch.bool)
    known[1, 2] = False
    _, valid = normals_from_depth(torch.full((4, 4), 3.0), known, view_of(4, 4))
    expected = torch.zeros(4, 4, dtype=torch.bool)
    expected[:3, :3] = True
    for row, column in ((1, 2), (1, 1), (0, 2)):
        expected[row, column] = False
    assert torch.equal(valid, expected)


def test_normal_loss_by_hand() -> None:
    """A fronto-parallel render against a plane tilted to n = (0.6, 0, 0.8): distance 0.6 + 0 + 0.2 everywhere."""
    view = view_of(6, 7, focal=40.0)
    tilted, front = plane_depth(view, (0.6, 0.0, 0.8), 5.0), plane_depth(view, (0.0, 0.0, 1.0), 5.0)
    alpha = torch.ones_like(front)
    loss = NormalLoss(NormalConfig("normal"))
    assert float(loss.loss(alpha, front, alpha, flat_target(tilted, view))) == pytest.approx(0.8, rel=1e-9)
    assert float(loss.loss(alpha, tilted, alpha, flat_target(tilted, view))) == pytest.approx(0.0, abs=1e-9)
    # Where the render covers nothing, or stereo knows nothing, there is nothing to compare.
    assert float(loss.loss(alpha, front, 0.4 * alpha, flat_target(tilted, view))) == 0.0
    nothing = torch.zeros_like(alpha, dtype=torch.bool)
    assert float(loss.loss(alpha, front, alpha, flat_target(tilted, view, nothing))) == 0.0


def test_smooth_is_zero_on_a_plane_and_has_the_hand_value_at_a_crease() -> None:
    """Two planes that meet between columns 5 and 6, with normals (0, 0, 1) and (0.6, 0, 0.8) (from behind).

    The normal of column 5 mixes both planes (its right neighbour lies on the other one). So each row sums
    |n4 - n5| + |n5 - n6|, with n5 from the points themselves, over the valid pixels.
    """
    view = view_of(7, 12, focal=40.0)
    left, right = plane_depth(view, (0.0, 0.0, 1.0), 5.0), plane_depth(view, (0.6, 0.0, 0.8), 5.0)
    ones = torch.ones_like(left)
    term = SmoothLoss(SmoothConfig("smooth"))
    for plane in (left, right):
        assert float(term.loss(ones, plane, ones, flat_target(plane, view))) < 1e-5
    crease = torch.cat([left[:, :6], right[:, 6:]], 1)
    total = 0.0
    points = np.stack(
        [
            (np.arange(12) - view.cx)[None, :] / view.fx * crease.numpy(),
            (np.arange(7) - view.cy)[:, None] / view.fy * crease.numpy(),
            crease.numpy(),
        ],
        -1,
    )
    for row in range(6):
        edge = np.cross(points[row + 1, 5] - points[row, 5], points[row, 6] - points[row, 5])
        middle = edge / np.linalg.norm(edge)
        total += np.linalg.norm(middle - [0, 0, -1]) + np.linalg.norm(middle - [-0.6, 0, -0.8])
        if row:  # the mixed normal turns a little from row to row
            above = np.cross(points[row, 5] - points[row - 1, 5], points[row - 1, 6] - points[row - 1, 5])
            total += np.linalg.norm(middle - above / np.linalg.norm(above))
    got = float(term.loss(ones, crease, ones, flat_target(crease, view)))
    assert got == pytest.approx(total / (6 * 11), rel=1e-4)
    assert got > 0.01


def test_smooth_with_several_distances_adds_them() -> None:
    rendered, target = random_case(14, 16, seed=1)
    args = (rendered.color.double(), rendered.depth.double(), torch.ones(14, 16), target)
    one, three = (SmoothLoss(SmoothConfig("smooth", distances=d)).loss(*args) for d in ((1,), (3,)))
    both = SmoothLoss(SmoothConfig("smooth", distances=(1, 3))).loss(*args)
    assert float(both) == pytest.approx(float(one) + float(three), rel=1e-9)


def test_edges_and_the_mask_excuse_what_is_not_smooth() -> None:
    """A step of depth between columns 5 and 6 with an edge of grey 0.5 and of 4 in 8 m: each factor by hand."""
    view = view_of(7, 12, focal=40.0)
    step = torch.cat([torch.full((7, 6), 4.0), torch.full((7, 6), 8.0)], 1).double()
    ones = torch.ones_like(step)
    target = flat_target(step, view)
    image = target.image.clone()
    image[:, :, 6:] += 0.5

    def value(**settings: Any) -> float:
        term = SmoothLoss(SmoothConfig("smooth", form="slopes", **settings))
        return float(term.loss(ones, step, ones, replace(target, image=image)))

    # Column 5's normal is (-4, 0, 1), all others are (0, 0, 1): two differences in each of 6 rows. Equal normals count
    # 1e-6, the epsilon.
    length = float(np.linalg.norm(np.array([-4.0, 0.0, 1.0]) / np.sqrt(17) - [0, 0, 1]))
    assert value() == pytest.approx(2 * length / 11, abs=3e-6)
    assert value(squared=True) == pytest.approx(2 * length**2 / 11, rel=1e-9)
    for edges, edge in (("color", 0.5), ("depth", 1.0)):
        # The edge lies between columns 5 and 6; columns 4 and 5 are alike.
        expected = length * (1 + np.exp(-3 * edge)) / 11
        assert value(edges=edges, edge_scale=3.0) == pytest.approx(expected, abs=3e-6)
    target = flat_target(step, view, torch.zeros_like(step, dtype=torch.bool))
    assert value(pixels="supervised") == 0.0
    assert value(edges="depth") == pytest.approx(2 * length / 11, abs=3e-6), "unknown depth excuses nothing"


@pytest.mark.parametrize("term", [NormalLoss, SmoothLoss])
def test_normals_of_depth_over_alpha_do_not_see_alpha(term: type[CoreLoss]) -> None:
    """Depth and alpha scaled alike are the same surface."""
    rendered, target = in_double(*random_case(9, 11, seed=4))
    name = "normal" if term is NormalLoss else "smooth"
    config = {NormalLoss: NormalConfig, SmoothLoss: SmoothConfig}[term](name, rendered_depth="normalized")
    covered = rendered.alpha.clamp_min(0.6)
    one, other = (
        float(term(config).loss(rendered.color, rendered.depth * alpha, alpha, target))
        for alpha in (covered, torch.ones_like(covered))
    )
    assert one == pytest.approx(other, rel=1e-9)
    assert one > 0


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ({"form": "planes"}, "loss.smooth.form='planes' is not one of points, slopes"),
        ({"step": 0}, "loss.smooth.step=0 must be at least 1 pixel"),
        ({"rendered_depth": "mean"}, "loss.smooth.rendered_depth='mean' is not one of"),
        ({"pixels": "sky"}, "loss.smooth.pixels='sky' is not one of"),
        ({"edges": "colour"}, "loss.smooth.edges='colour' is not one of none, color, depth"),
        ({"edge_scale": -1.0}, "loss.smooth.edge_scale"),
    ],
)
def test_readings_are_checked(setting: dict[str, Any], told: str) -> None:
    with pytest.raises(BenchError, match=re.escape(told)):
        SmoothConfig("smooth", **setting)


TERMS: dict[str, Callable[[], LossTerm]] = {
    "geo raw": lambda: GeoLoss(GeoConfig("geo")),
    "geo dense": lambda: GeoLoss(GeoConfig("geo", stride=1, edge_weighted=False)),
    "geo confident": lambda: GeoLoss(GeoConfig("geo", confidence_weighted=True)),
    "geo normalized": lambda: GeoLoss(GeoConfig("geo", rendered_depth="normalized")),
    "normal": lambda: NormalLoss(NormalConfig("normal")),
    "normal slopes": lambda: NormalLoss(NormalConfig("normal", form="slopes", step=2, rendered_depth="normalized")),
    "smooth": lambda: SmoothLoss(SmoothConfig("smooth", distances=(1, 2))),
    "smooth points": lambda: SmoothLoss(SmoothConfig("smooth", step=2, edges="color", rendered_depth="normalized")),
    "smooth slopes": lambda: SmoothLoss(SmoothConfig("smooth", form="slopes", pixels="supervised", edges="depth")),
    "smooth squared": lambda: SmoothLoss(SmoothConfig("smooth", form="slopes", squared=True)),
}


@pytest.mark.parametrize("name", TERMS)
def test_gradients_against_central_differences(name: str) -> None:
    """In float64, by depth and alpha. The coverage test of normal and smooth is a constant, so alpha stays off 0.5."""
    rendered, target = in_double(*random_case(9, 11, seed=8))
    rendered.alpha[(rendered.alpha - 0.5).abs() < 1e-3] = 0.6
    term = TERMS[name]()
    result = term.evaluate(rendered, target)
    step = 1e-6
    for what in ("depth", "alpha"):
        base = getattr(rendered, what)
        expected = torch.zeros_like(base)
        for k in range(base.numel()):
            values = []
            for sign in (1, -1):
                moved = base.clone()
                moved.view(-1)[k] += sign * step
                images = {"depth": rendered.depth, "alpha": rendered.alpha, what: moved}
                values.append(term.evaluate(Rendered(rendered.color, **images), target).value)
            expected.view(-1)[k] = (values[0] - values[1]) / (2 * step)
        got = getattr(result, f"grad_{what}")
        got = torch.zeros_like(base) if got is None else got
        torch.testing.assert_close(got, expected, rtol=1e-5, atol=1e-8)
    assert result.grad_color is None


def test_normal_gradients_are_finite_without_depth() -> None:
    """Where nothing is rendered the depth is zero; its neighbours' normals must not make NaN."""
    rendered, target = random_case(8, 8, seed=2)
    empty = Rendered(rendered.color, torch.zeros(8, 8), torch.zeros(8, 8))
    for name in ("normal", "smooth"):
        grad = TERMS[name]().evaluate(empty, target).grad_depth
        assert grad is not None
        assert bool(torch.isfinite(grad).all())
