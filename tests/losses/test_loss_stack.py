"""The weighted sum, and a term that a user writes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import torch
from loss_cases import random_case
from torch import Tensor

from bench import _native, registry
from bench.contracts.loss import LossConfig, TorchLoss
from bench.gaussians.loss_stack import LossStack
from bench.registry import register
from bench.supervision.target import Target
from plugins.losses.geo import GeoConfig, GeoLoss
from plugins.losses.normal import NormalConfig, NormalLoss
from plugins.losses.rgb import RgbConfig, RgbLoss
from plugins.losses.smooth import SmoothConfig, SmoothLoss
from plugins.losses.ssim import SsimConfig, SsimLoss


@dataclass(frozen=True)
class OpaqueConfig(LossConfig):
    """Settings of the example of the contract's documentation."""

    wanted: float = 1.0


@register("loss", "opaque_for_tests", config=OpaqueConfig)
class OpaqueLoss(TorchLoss):
    """Mean squared distance of alpha to a wanted value."""

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        return ((alpha - self.config.wanted) ** 2).mean()


@register("loss", "constant_for_tests", config=LossConfig)
class ConstantLoss(TorchLoss):
    """Depends on nothing."""

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        return torch.tensor(3.0)


def test_a_users_term_takes_part() -> None:
    """d/dalpha of the mean of (alpha - 0.9)^2 is 2 (alpha - 0.9) / n, times the weight."""
    rendered, target = random_case(5, 6, seed=1)
    mine = registry.build(OpaqueConfig("opaque_for_tests", weight=0.25, wanted=0.9), "loss")
    values, (color, depth, alpha) = LossStack([mine, RgbLoss(RgbConfig("rgb", 2.0))]).evaluate(rendered, target)
    expected = ((rendered.alpha - 0.9) ** 2).mean()
    assert values["opaque_for_tests"] == pytest.approx(float(expected), rel=1e-6)
    assert alpha is not None
    torch.testing.assert_close(alpha, 0.25 * 2 * (rendered.alpha - 0.9) / 30)
    assert color is not None
    torch.testing.assert_close(color, 2.0 * torch.sign(rendered.color - target.image) / 90)
    assert depth is None


def test_masked_pixels_are_not_seen_by_terms_on_colour() -> None:
    """L1 by hand: the mean over all pixels of the error where the mask is true."""
    rendered, target = random_case(5, 6, seed=3)
    mask = target.depth_mask
    stack = LossStack([RgbLoss(RgbConfig("rgb", 2.0)), SsimLoss(SsimConfig("ssim", 0.5))])
    values, (color, _, _) = stack.evaluate(rendered, replace(target, color_mask=mask))
    error = (rendered.color - target.image).abs() * mask
    assert values["rgb"] == pytest.approx(float(error.mean()), rel=1e-6)
    assert color is not None
    assert not color[:, ~mask].any()
    assert color[:, mask].all()
    nothing = replace(target, color_mask=torch.zeros_like(mask))
    values, (color, _, _) = stack.evaluate(rendered, nothing)
    assert values == pytest.approx({"rgb": 0.0, "ssim": 0.0}, abs=1e-6)


def test_gradients_of_several_terms_add_up() -> None:
    rendered, target = random_case(12, 14, seed=2)
    geo, normal = GeoLoss(GeoConfig("geo", 0.3)), NormalLoss(NormalConfig("normal", 0.7))
    separate = [term.evaluate(rendered, target).grad_depth for term in (geo, normal)]
    _, (_, depth, _) = LossStack([geo, normal]).evaluate(rendered, target)
    assert depth is not None
    assert separate[0] is not None
    assert separate[1] is not None
    torch.testing.assert_close(depth, 0.3 * separate[0] + 0.7 * separate[1])


@pytest.mark.parametrize("first", ["geo", "normal"])
def test_weights_inside_the_kernels_are_those_of_torch(first: str) -> None:
    """The core multiplies and adds in the order and with the roundings of grad * w and torch.add(alpha=w)."""
    rendered, target = random_case(21, 19, seed=5)
    geo = GeoLoss(GeoConfig("geo", 0.3, rendered_depth="normalized"))
    normal, smooth = NormalLoss(NormalConfig("normal", 0.7)), SmoothLoss(SmoothConfig("smooth", 0.9))
    terms = [geo, normal, smooth] if first == "geo" else [normal, smooth, geo]
    expected: dict[str, Tensor | None] = {"depth": None, "alpha": None}
    for term in terms:
        value = term.evaluate(rendered, target)
        for image, sofar in expected.items():
            grad = getattr(value, f"grad_{image}")
            if grad is not None:
                weighted = grad * term.config.weight
                expected[image] = weighted if sofar is None else torch.add(sofar, grad, alpha=term.config.weight)
    _, (_, depth, alpha) = LossStack(terms).evaluate(rendered, target)
    assert depth is not None
    assert alpha is not None
    if _native.instruction_set() == "baseline":  # torch fuses multiplication and addition where the machine can
        torch.testing.assert_close(depth, expected["depth"])
        torch.testing.assert_close(alpha, expected["alpha"])
    else:
        assert torch.equal(depth, expected["depth"])  # type: ignore[arg-type]
        assert torch.equal(alpha, expected["alpha"])  # type: ignore[arg-type]


def test_a_constant_term_has_no_gradient() -> None:
    rendered, target = random_case(4, 4, seed=3)
    values, gradients = LossStack([ConstantLoss(LossConfig("constant_for_tests"))]).evaluate(rendered, target)
    assert values == {"constant_for_tests": 3.0}
    assert gradients == (None, None, None)


def test_no_term_at_all() -> None:
    rendered, target = random_case(4, 4, seed=3)
    assert LossStack([]).evaluate(rendered, target) == ({}, (None, None, None))
