"""Adam in the C++ core against torch.optim.Adam, and what it must leave alone."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from bench.contracts.rasterizer import Gradients
from bench.gaussians.optimizer import BETA1, BETA2, EPSILON, LearningRates, MapOptimizer

RATES = LearningRates(position=1e-3, color=1e-2, opacity=5e-2, scale=5e-3, rotation=2e-3)
ROWS = {"position": slice(0, 3), "scale": slice(3, 6), "rotation": slice(6, 10), "opacity": slice(10, 11)}
ROWS["color"] = slice(11, 14)


def optimizer(count: int) -> MapOptimizer:
    made = MapOptimizer(RATES, torch.device("cpu"))
    made.grow(count)
    return made


def gradients(generator: torch.Generator, count: int, touched: Tensor | None = None) -> Gradients:
    planes = torch.randn(14, count, generator=generator)
    return Gradients(planes, torch.ones(count, dtype=torch.bool) if touched is None else touched, None)


@pytest.mark.parametrize("count", [1, 8, 13, 2050])
def test_dense_steps_are_those_of_torch(count: int) -> None:
    generator = torch.Generator().manual_seed(1)
    start = torch.randn(14, count, generator=generator)
    birth = torch.rand(count, generator=generator) * 10 + 0.5
    mine, planes = optimizer(count), start.clone()
    # The position's rate differs from Gaussian to Gaussian. Adam's step is linear in the rate, so torch steps at the
    # common rate and the displacement is scaled afterwards.
    groups = {name: torch.nn.Parameter(start[rows].double()) for name, rows in ROWS.items()}
    theirs = torch.optim.Adam(
        [{"params": [parameter], "lr": getattr(RATES, name)} for name, parameter in groups.items()],
        betas=(BETA1, BETA2),
        eps=EPSILON,
    )
    for _ in range(7):
        step = gradients(generator, count)
        mine.step(planes, step, birth)
        for name, rows in ROWS.items():
            groups[name].grad = step.planes[rows].double()
        theirs.step()
    for name, rows in ROWS.items():
        moved = groups[name].detach() - start[rows].double()
        expected = start[rows].double() + moved * (birth.double() if name == "position" else 1.0)
        torch.testing.assert_close(planes[rows].double(), expected, rtol=0, atol=2e-5 * float(moved.abs().max()) + 1e-6)


def test_untouched_gaussians_are_frozen_with_their_moments() -> None:
    """A Gaussian that was not seen for a step goes on as if the step had not been, except for the bias correction."""
    generator = torch.Generator().manual_seed(2)
    count = 21
    touched = torch.rand(count, generator=generator) < 0.5
    planes = torch.randn(14, count, generator=generator)
    mine = optimizer(count)
    mine.step(planes, gradients(generator, count), torch.ones(count))
    before = (planes.clone(), mine._first.clone(), mine._second.clone())
    mine.step(planes, gradients(generator, count, touched), torch.ones(count))
    for now, then in zip((planes, mine._first, mine._second), before, strict=True):
        assert torch.equal(now[:, ~touched], then[:, ~touched])
        assert bool((now[:, touched] != then[:, touched]).all())


def test_first_step_by_hand() -> None:
    """Adam's first step is -rate * sign(gradient), whatever the gradient's size; positions times the depth at birth."""
    planes = torch.zeros(14, 2)
    step = Gradients(torch.full((14, 2), 1e-4), torch.ones(2, dtype=torch.bool), None)
    step.planes[:, 1] = -7.0
    optimizer(2).step(planes, step, torch.tensor([2.0, 5.0]))
    rates = torch.tensor([1e-3] * 3 + [5e-3] * 3 + [2e-3] * 4 + [5e-2] + [1e-2] * 3)
    factor = torch.tensor([[2.0, 5.0]]).repeat(3, 1)
    expected = rates[:, None] * torch.tensor([[-1.0, 1.0]])
    expected[:3] *= factor
    torch.testing.assert_close(planes, expected, rtol=1e-5, atol=0)


def test_growing_and_shrinking_keep_each_gaussians_moments() -> None:
    generator = torch.Generator().manual_seed(3)
    mine, planes = optimizer(5), torch.zeros(14, 5)
    mine.step(planes, gradients(generator, 5), torch.ones(5))
    kept = torch.tensor([True, False, True, True, False])
    first, second = mine._first[:, kept].clone(), mine._second[:, kept].clone()
    mine.keep(kept)
    mine.grow(2)
    assert torch.equal(mine._first[:, :3], first)
    assert torch.equal(mine._second[:, :3], second)
    assert float(mine._first[:, 3:].abs().sum() + mine._second[:, 3:].abs().sum()) == 0.0
    mine.step(torch.zeros(14, 5), gradients(generator, 5), torch.ones(5))


def test_torch_form_is_the_same_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """The form for other devices, run here on a CPU tensor that claims to lie elsewhere, against the C++ one."""
    generator = torch.Generator().manual_seed(4)
    count = 19
    start = torch.randn(14, count, generator=generator)
    birth = torch.rand(count, generator=generator) + 0.5
    steps = [gradients(generator, count, torch.rand(count, generator=generator) < 0.7) for _ in range(4)]
    native, mine = optimizer(count), start.clone()
    for step in steps:
        native.step(mine, step, birth)
    general, other = optimizer(count), start.clone()

    class ElsewhereTensor(torch.Tensor):
        """A CPU tensor that says that it lies on another kind of device."""

        @property
        def device(self) -> object:  # type: ignore[override]
            return type("Device", (), {"type": "elsewhere"})()

    monkeypatch.setattr(torch, "tensor", lambda data, device=None: torch.Tensor(data))
    for step in steps:
        general.step(other.as_subclass(ElsewhereTensor), step, birth)
    torch.testing.assert_close(torch.Tensor(other), mine, rtol=1e-5, atol=1e-6)
