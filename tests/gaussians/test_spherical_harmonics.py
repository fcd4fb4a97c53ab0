"""Harmonics against scipy's, their rotation against their values, and the colour of a map worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y
from torch import Tensor

from bench.gaussians.parameters import planes_from
from bench.gaussians.schema import HARMONICS, MAX_DEGREE, planes_of
from bench.gaussians.spherical_harmonics import band_rotation, basis, coefficients, colors


def directions(count: int, seed: int) -> Tensor:
    values = np.random.default_rng(seed).normal(size=(count, 3))
    return torch.from_numpy(values / np.linalg.norm(values, axis=1, keepdims=True))


def test_basis_is_that_of_scipy() -> None:
    """Of the complex Y_lm, which hold the Condon-Shortley phase: sqrt 2 Im Y_l|m|, Y_l0, sqrt 2 Re Y_lm."""
    d = directions(50, 1)
    polar, azimuth = np.arccos(d[:, 2].numpy()), np.arctan2(d[:, 1].numpy(), d[:, 0].numpy())
    expected = []
    for band in range(MAX_DEGREE + 1):
        for m in range(-band, band + 1):
            value = sph_harm_y(band, abs(m), polar, azimuth)
            expected.append(value.real if m == 0 else np.sqrt(2) * (value.imag if m < 0 else value.real))
    torch.testing.assert_close(basis(d, MAX_DEGREE), torch.from_numpy(np.stack(expected, 1)), rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_lower_degrees_are_the_first_of_higher_ones(degree: int) -> None:
    d = directions(5, 2)
    assert torch.equal(basis(d, degree), basis(d, 3)[:, : (degree + 1) ** 2])


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rotated_coefficients_have_the_old_value_in_the_turned_direction(degree: int) -> None:
    for seed in range(5):
        R = torch.from_numpy(Rotation.random(random_state=seed).as_matrix())
        block, d = band_rotation(R, degree), directions(20, seed)
        c = torch.from_numpy(np.random.default_rng(seed).normal(size=len(block)))
        before, after = basis(d, degree)[:, 1:] @ c, basis(d @ R.T, degree)[:, 1:] @ (block @ c)
        torch.testing.assert_close(after, before, rtol=0, atol=1e-12)
        torch.testing.assert_close(block @ block.T, torch.eye(len(block), dtype=torch.float64), rtol=0, atol=1e-12)
        assert float(block[:3, 3:].abs().sum()) == 0.0


def test_rotation_of_degree_zero_is_empty_and_types_are_kept() -> None:
    assert band_rotation(torch.eye(3), 0).shape == (0, 0)
    block = band_rotation(torch.eye(3), 2)
    assert block.dtype == torch.float32
    torch.testing.assert_close(block, torch.eye(8), rtol=0, atol=1e-6)


def test_colour_of_one_gaussian_by_hand() -> None:
    """Seen along +z only the harmonic m = 0 of degree 1 speaks: sqrt(3 / 4 pi) * 0.4 = 0.195 more of green."""
    one = planes_from(*(torch.tensor([v]) for v in ([1.0, 2, 7], [0.1] * 3, [1.0, 0, 0, 0], 0.5, [0.5, 0.5, 0.0])))
    planes = torch.cat([one, torch.zeros(planes_of(1) - planes_of(0), 1)])
    planes[HARMONICS.start + 3 * (2 - 1) + 1] = 0.4
    assert coefficients(planes)[0, 2].tolist() == pytest.approx([0.0, 0.4, 0.0])
    seen = colors(planes, torch.tensor([1.0, 2.0, 3.0]))[:, 0]
    assert seen.tolist() == pytest.approx([0.5, 0.5 + 0.4 * np.sqrt(3 / (4 * np.pi)), 0.0], abs=1e-6)
    behind = colors(planes, torch.tensor([1.0, 2.0, 9.0]))[:, 0]
    assert behind.tolist() == pytest.approx([0.5, 0.5 - 0.4 * np.sqrt(3 / (4 * np.pi)), 0.0], abs=1e-6)
