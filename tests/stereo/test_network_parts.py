"""The networks' fast parts against the plain definition of what they compute, in float64 where that matters."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from bench.stereo.networks.anynet import AnyNet, FastAnyNet, correction_volume, full_volume
from bench.stereo.networks.concat_volume import volume_convolution
from bench.stereo.networks.folding import fold_batch_norms
from bench.stereo.networks.planes import banded_weight
from bench.stereo.networks.psmnet import PsmNet
from bench.stereo.networks.single_output import SingleOutputConv3d
from bench.stereo.networks.soft_argmin import upsampled_soft_argmin


@pytest.fixture(autouse=True)
def _fixed_seed() -> None:
    torch.manual_seed(0)


def random_like_trained(network: nn.Module) -> nn.Module:
    """The network in evaluation mode with normalisations that do something."""
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
            for values, low, high in (
                (module.weight.data, 0.5, 1.5),
                (module.bias.data, -0.5, 0.5),
                (module.running_mean, -0.5, 0.5),
                (module.running_var, 0.5, 2.0),
            ):
                assert values is not None
                values.uniform_(low, high)
    return network.eval().requires_grad_(False)


@pytest.mark.parametrize(("width", "disparities"), [(13, 6), (4, 9), (7, 2), (20, 12), (1, 4)])
@pytest.mark.parametrize("with_bias", [True, False])
def test_volume_convolution_is_that_of_the_whole_volume(width: int, disparities: int, with_bias: bool) -> None:
    left, right = torch.randn(2, 1, 3, 5, width, dtype=torch.float64)
    weight = torch.randn(4, 6, 3, 3, 3, dtype=torch.float64)
    bias = torch.randn(4, dtype=torch.float64) if with_bias else None
    volume = torch.zeros(1, 6, disparities, 5, width, dtype=torch.float64)
    for d in range(disparities):
        for x in range(d, width):
            volume[0, :3, d, :, x] = left[0, :, :, x]
            volume[0, 3:, d, :, x] = right[0, :, :, x - d]
    expected = functional.conv3d(volume, weight, bias, padding=1)
    torch.testing.assert_close(volume_convolution(left, right, weight, bias, disparities), expected)


def test_single_output_convolution() -> None:
    layer = SingleOutputConv3d(5).requires_grad_(False)
    values = torch.randn(1, 5, 11, 6, 7)
    expected = functional.conv3d(values.double(), layer.weight.double(), padding=1)
    torch.testing.assert_close(layer(values).double(), expected, atol=1e-5, rtol=1e-5)


def test_banded_convolution() -> None:
    values = torch.randn(1, 2, 5, 6, 7, dtype=torch.float64)
    weight = torch.randn(3, 2, 3, 3, 3, dtype=torch.float64)
    expected = functional.conv3d(values, weight, padding=1)
    got = functional.conv2d(values.flatten(1, 2), banded_weight(weight, 5), padding=1)
    torch.testing.assert_close(got.view(1, 3, 5, 6, 7), expected)


def test_soft_argmin_is_that_of_the_trilinear_volume() -> None:
    score = 5 * torch.randn(6, 4, 9)
    volume = functional.interpolate(score[None, None].double(), (24, 16, 36), mode="trilinear", align_corners=True)[
        0, 0
    ]
    share = torch.softmax(volume, dim=0)
    expected = (share * torch.arange(24.0).view(-1, 1, 1)).sum(0)
    got = upsampled_soft_argmin(score, 24, (16, 36))
    assert got.shape == (1, 1, 16, 36)
    torch.testing.assert_close(got[0, 0].double(), expected, atol=1e-4, rtol=1e-5)


def test_soft_argmin_survives_large_scores() -> None:
    score = torch.full((4, 2, 2), -1e4)
    score[2] = 1e4
    # The third of four levels, at 2 / 3 of the eight disparities 0 .. 7; the nearest whole one wins.
    torch.testing.assert_close(upsampled_soft_argmin(score, 8, (2, 2)), torch.full((1, 1, 2, 2), 5.0), atol=0.1, rtol=0)


def test_anynet_costs() -> None:
    left, right = torch.rand(2, 1, 2, 3, 20)
    full = full_volume(left, right, 4)
    assert float(full[0, 3, 1, 10]) == pytest.approx(float((left[0, :, 1, 10] - right[0, :, 1, 7]).abs().sum()))
    # Outside the right image there is 0 to compare with.
    assert float(full[0, 3, 1, 2]) == pytest.approx(float(left[0, :, 1, 2].abs().sum()))
    around = correction_volume(left, right, torch.full((1, 1, 3, 20), 5.5))
    between = (right[0, :, 1, 6] + right[0, :, 1, 7]) / 2
    # The plane of correction -2 looks at disparity 5.5 + 2, so at column 14 at 6.5.
    assert float(around[0, 0, 1, 14]) == pytest.approx(float((left[0, :, 1, 14] - between).abs().sum()), abs=1e-5)


def test_fast_anynet_equals_its_definition() -> None:
    network = random_like_trained(AnyNet())
    assert isinstance(network, AnyNet)
    left, right = torch.randn(2, 1, 3, 64, 96)
    torch.testing.assert_close(FastAnyNet(network)(left, right), network(left, right), atol=2e-4, rtol=1e-4)


def test_folded_psmnet_equals_the_unfolded() -> None:
    network = random_like_trained(PsmNet())
    folded = copy.deepcopy(network)
    fold_batch_norms(folded)
    assert not [module for module in folded.modules() if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d)]
    pair: Tensor = torch.randn(2, 1, 3, 16, 32)
    torch.testing.assert_close(folded(*pair), network(*pair), atol=0.02, rtol=0)
