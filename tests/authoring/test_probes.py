"""The test images themselves, and the measuring of memory."""

from __future__ import annotations

import numpy as np
import pytest

from bench.authoring.cost import cost_of, describe_cost
from bench.authoring.loss_checks import make_case
from bench.authoring.probes import shifted_pair, texture
from bench.authoring.verdict import ContractBrokenError


@pytest.mark.parametrize("shift", [1, 17, 41])
def test_a_shifted_pair_is_shifted_by_whole_pixels(shift: int) -> None:
    """By the definition: what the left image has at x, the right one has at x - shift."""
    left, right = shifted_pair(61, 203, shift)
    assert left.shape == right.shape == (61, 203, 3)
    np.testing.assert_array_equal(left[:, shift:], right[:, :-shift])


def test_the_texture_has_contrast_at_every_place() -> None:
    image = texture(120, 200).astype(float).mean(axis=2)
    blocks = image.reshape(6, 20, 10, 20).swapaxes(1, 2).reshape(60, -1)
    assert blocks.std(axis=1).min() > 8
    assert texture(50, 60, seed=1).tobytes() == texture(50, 60, seed=1).tobytes()
    assert texture(50, 60, seed=1).tobytes() != texture(50, 60, seed=2).tobytes()


@pytest.mark.slow
def test_a_leak_of_known_size_is_measured() -> None:
    kept: list[np.ndarray] = []
    cost = cost_of(lambda: kept.append(np.ones(500_000)))
    if cost.left_mb is None:
        pytest.skip("no /proc here")
    assert np.mean(cost.left_mb[1:]) == pytest.approx(4.0, rel=0.1)
    with pytest.raises(ContractBrokenError, match=r"left 4\.\d MB behind"):
        describe_cost(cost, 4.0, "disparity")
    assert "nothing left behind" in str(describe_cost(cost_of(lambda: np.ones(500_000)), 4.0, "disparity"))


def test_the_loss_case_is_a_render_that_could_be() -> None:
    """Depth that supervises is known; depth = sum d a T is at most the farthest depth times alpha."""
    rendered, target = make_case(24, 40, seed=1)
    assert bool((target.depth[target.depth_mask] >= 3).all())
    assert bool((target.depth[~target.depth_mask] == 0).all())
    assert bool((rendered.depth <= 8 * rendered.alpha).all())
