"""Adam in the C++ core against torch.optim.Adam, and what it must leave alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.contracts.rasterizer import Gradients
from bench.gaussians.map import GaussianMap
from bench.gaussians.optimizer import BETA1, EPSILON, LearningRates, MapOptimizer, _step_in_torch

RATES = LearningRates(position=1e-3, color=1e-2, opacity=5e-2, scale=5e-3, rotation=2e-3)
ROWS = {"position": slice(0, 3), "scale": slice(3, 6), "rotation": slice(6, 10), "opacity": slice(10, 11)}
ROWS["color"] = slice(11, 14)


def map_of(planes: Tensor, birth_depth: Tensor | None = None) -> GaussianMap:
    """A map of one keyframe with a copy of these parameters; birth depths are 1 unless said."""
    made = GaussianMap({14: 0, 23: 1}[len(planes)], torch.device("cpu"))
    made.add(0, np.eye(4), planes, torch.ones(planes.shape[1]) if birth_depth is None else birth_depth)
    return made


def gradients(generator: torch.Generator, count: int, touched: Tensor | None = None) -> Gradients:
    planes = torch.randn(14, count, generator=generator)
    return Gradients(planes, torch.ones(count, dtype=torch.bool) if touched is None else touched, None)


@pytest.mark.parametrize("count", [1, 8, 13, 2050])
def test_dense_steps_are_those_of_torch(count: int) -> None:
    generator = torch.Generator().manual_seed(1)
    start = torch.randn(14, count, generator=generator)
    birth = torch.rand(count, generator=generator) * 10 + 0.5
    mine, optimizer = map_of(start, birth), MapOptimizer(RATES)
    # The position's rate differs from Gaussian to Gaussian. Adam's step is linear in the rate, so torch steps at the
    # common rate and the displacement is scaled afterwards.
    groups = {name: torch.nn.Parameter(start[rows].double()) for name, rows in ROWS.items()}
    theirs = torch.optim.Adam(
        [{"params": [parameter], "lr": getattr(RATES, name)} for name, parameter in groups.items()],
        betas=(BETA1, 0.999),
        eps=EPSILON,
    )
    for _ in range(7):
        step = gradients(generator, count)
        optimizer.step(mine, step)
        for name, rows in ROWS.items():
            groups[name].grad = step.planes[rows].double()
        theirs.step()
    for name, rows in ROWS.items():
        moved = groups[name].detach() - start[rows].double()
        expected = start[rows].double() + moved * (birth.double() if name == "position" else 1.0)
        torch.testing.assert_close(
            mine.planes[rows].double(), expected, rtol=0, atol=2e-5 * float(moved.abs().max()) + 1e-6
        )


def test_untouched_gaussians_are_frozen_with_their_moments() -> None:
    """A Gaussian that was not seen for a step goes on as if the step had not been, except for the bias correction."""
    generator = torch.Generator().manual_seed(2)
    count = 21
    touched = torch.rand(count, generator=generator) < 0.5
    mine, optimizer = map_of(torch.randn(14, count, generator=generator)), MapOptimizer(RATES)
    optimizer.step(mine, gradients(generator, count))
    before = [column.clone() for column in (mine.planes, mine.first_moment, mine.second_moment)]
    optimizer.step(mine, gradients(generator, count, touched))
    for now, then in zip((mine.planes, mine.first_moment, mine.second_moment), before, strict=True):
        assert torch.equal(now[:, ~touched], then[:, ~touched])
        assert bool((now[:, touched] != then[:, touched]).all())


def test_first_step_by_hand() -> None:
    """Adam's first step is -rate * sign(gradient), whatever the gradient's size; positions times the depth at birth."""
    mine = map_of(torch.zeros(14, 2), torch.tensor([2.0, 5.0]))
    step = Gradients(torch.full((14, 2), 1e-4), torch.ones(2, dtype=torch.bool), None)
    step.planes[:, 1] = -7.0
    MapOptimizer(RATES).step(mine, step)
    rates = torch.tensor([1e-3] * 3 + [5e-3] * 3 + [2e-3] * 4 + [5e-2] + [1e-2] * 3)
    factor = torch.tensor([[2.0, 5.0]]).repeat(3, 1)
    expected = rates[:, None] * torch.tensor([[-1.0, 1.0]])
    expected[:3] *= factor
    torch.testing.assert_close(mine.planes, expected, rtol=1e-5, atol=0)


def test_higher_harmonics_learn_at_a_twentieth_of_the_colours_rate() -> None:
    mine = map_of(torch.zeros(23, 3))
    MapOptimizer(RATES).step(mine, Gradients(torch.ones(23, 3), torch.ones(3, dtype=torch.bool), None))
    torch.testing.assert_close(mine.planes[11:14], torch.full((3, 3), -1e-2), rtol=1e-5, atol=0)
    torch.testing.assert_close(mine.planes[14:], torch.full((9, 3), -1e-2 / 20), rtol=1e-5, atol=0)


def test_torch_form_is_the_same_step() -> None:
    """The form for other devices, run here on the CPU, against the C++ one."""
    generator = torch.Generator().manual_seed(4)
    count = 19
    start = torch.randn(14, count, generator=generator)
    birth = torch.rand(count, generator=generator) + 0.5
    steps = [gradients(generator, count, torch.rand(count, generator=generator) < 0.7) for _ in range(4)]
    native, general = map_of(start, birth), map_of(start, birth)
    optimizer, other = MapOptimizer(RATES), MapOptimizer(RATES)
    for step in steps:
        optimizer.step(native, step)
        _step_in_torch(other._next(general), step)
    torch.testing.assert_close(general.planes, native.planes, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("native", [True, False])
def test_gaussians_without_moments_are_frozen_and_rows_may_have_room_behind_them(native: bool) -> None:
    """The first 13 of 21 learn as they do alone, whatever else the rows' buffers hold."""
    generator = torch.Generator().manual_seed(5)
    count, learning = 21, 13
    start, birth = torch.randn(14, count, generator=generator), torch.rand(count, generator=generator) + 0.5
    alone, some, optimizer = map_of(start[:, :learning], birth[:learning]), map_of(start, birth), MapOptimizer(RATES)
    for name, length, room in (("planes", count, 3), ("first_moment", learning, 9), ("second_moment", learning, 2)):
        buffer = torch.full((14, length + room), torch.nan)
        buffer[:, :length] = getattr(some, name)[:, :length]
        setattr(some, name, buffer[:, :length])
    some.birth_depth = birth[:learning]
    for optimizer.steps in range(1, 4):
        step = gradients(generator, count, torch.rand(count, generator=generator) < 0.7)
        for gaussians, of in ((some, count), (alone, learning)):
            part = Gradients(step.planes[:, :of], step.touched[:of], None)
            optimizer.steps -= 1
            if native:
                optimizer.step(gaussians, part)
            else:
                _step_in_torch(optimizer._next(gaussians), part)
    assert torch.equal(some.planes[:, learning:], start[:, learning:])
    assert torch.equal(some.planes[:, :learning], alone.planes)
    assert torch.equal(some.first_moment, alone.first_moment)
    assert torch.equal(some.second_moment, alone.second_moment)
