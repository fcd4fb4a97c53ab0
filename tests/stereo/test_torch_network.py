"""What a torch network is fed, and what is made of its answer; checked against numbers worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from bench.errors import BenchError
from bench.stereo.network import NetworkConfig
from bench.stereo.torch_network import TorchStereo


class Watched(nn.Module):
    """Remembers what it is fed; its disparity is the column, counted in the padded image."""

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        self.fed = (left, right)
        self.computed_in = torch.nn.functional.conv2d(left, torch.ones(1, 3, 1, 1)).dtype
        return torch.arange(1.0, left.shape[3] + 1).expand(1, 1, *left.shape[2:])


class Net(TorchStereo):
    """Padded to 8 at top and right, as the defaults say."""

    pad_multiple = 8

    def load(self) -> nn.Module:
        return Watched()


class Answers(Net):
    """Its prediction is whatever ``answer`` makes of the left image."""

    answer: Any = None

    def predict(self, left: Tensor, right: Tensor) -> Tensor:
        answer: Tensor = self.answer(left)
        return answer


def pair(height: int, width: int) -> tuple[Any, Any]:
    rng = np.random.default_rng(0)
    left, right = (rng.integers(0, 256, (height, width, 3), np.uint8) for _ in range(2))
    return left, right


def test_images_are_padded_and_normalised() -> None:
    left, right = pair(13, 21)
    network = Net(NetworkConfig(device="cpu"))
    disparity = network.disparity(left, right)
    # Padding at the right leaves the columns where they are.
    np.testing.assert_array_equal(disparity, np.tile(np.arange(1, 22, dtype=np.float32), (13, 1)))
    watched = network.network
    assert isinstance(watched, Watched)
    for image, tensor in zip((left, right), watched.fed, strict=True):
        assert tensor.shape == (1, 3, 16, 24)
        assert tensor.dtype == torch.float32
        red, blue = image[5, 7, 0] / 255, image[5, 7, 2] / 255
        # Three rows were added at the top.
        assert float(tensor[0, 0, 8, 7]) == pytest.approx((red - 0.485) / 0.229, abs=1e-5)
        assert float(tensor[0, 2, 8, 7]) == pytest.approx((blue - 0.406) / 0.225, abs=1e-5)
        assert torch.equal(tensor[0, :, 0, :21], tensor[0, :, 3, :21])


def test_plain_colours() -> None:
    class Plain(Net):
        mean = (0.0, 0.0, 0.0)
        std = (1 / 255, 1 / 255, 1 / 255)

    left, right = pair(8, 8)
    network = Plain(NetworkConfig(device="cpu"))
    network.disparity(left, right)
    watched = network.network
    assert isinstance(watched, Watched)
    np.testing.assert_allclose(watched.fed[0][0].permute(1, 2, 0).numpy(), left, atol=1e-3)


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
def test_computes_in_the_wanted_format(dtype: str) -> None:
    network = Net(NetworkConfig(device="cpu", dtype=dtype))
    disparity = network.disparity(*pair(8, 8))
    assert isinstance(network.network, Watched)
    assert network.network.computed_in == getattr(torch, dtype)
    assert disparity.dtype == np.float32


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda left: [left], r"Answers\.predict returned list; return a tensor"),
        (lambda left: left, r"returned a tensor of shape \(1, 3, 16, 24\); expected \(1, 1, 16, 24\)"),
        (
            lambda left: left[:, :1, ::2, ::2],
            r"expected \(1, 1, 16, 24\), .*: it is at 1/2 of the size, .* multiply by 2",
        ),
        (lambda left: left[:, :1].mT, r"shape \(1, 1, 24, 16\); .*: height and width are exchanged, transpose it"),
        (lambda left: left[:, :1, :13, :21], r"shape \(1, 1, 13, 21\); expected \(1, 1, 16, 24\), .* padded image"),
    ],
)
def test_wrong_predictions(answer: Any, message: str) -> None:
    network = Answers(NetworkConfig(device="cpu"))
    network.answer = answer
    with pytest.raises(BenchError, match=message):
        network.disparity(*pair(13, 21))


@pytest.mark.parametrize("shape", [(13, 21), (1, 13, 21), (1, 1, 13, 21)])
def test_leading_ones_do_not_matter(shape: tuple[int, ...]) -> None:
    class NoPadding(Answers):
        pad_multiple = 1

    network = NoPadding(NetworkConfig(device="cpu"))
    network.answer = lambda left: torch.full(shape, 2.0)
    assert (network.disparity(*pair(13, 21)) == 2).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"device": "gpu"}, r"stereo\.device='gpu' is not one of auto, cpu, cuda"),
        ({"device": "cpu:1"}, r"stereo\.device=cpu:1: there are \d+ CUDA devices here"),
        ({"dtype": "half"}, r"stereo\.dtype='half' is not one of float32, bfloat16, float16"),
    ],
)
def test_wrong_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Net(NetworkConfig(**settings))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_missing_cuda() -> None:
    with pytest.raises(
        BenchError, match=r"stereo\.device=cuda: torch finds no CUDA device here\. Use stereo\.device=cpu"
    ):
        Net(NetworkConfig(device="cuda"))
