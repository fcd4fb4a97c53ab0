"""The exceptions that authors of networks meet, raised by torch itself where it can raise them here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from bench.authoring.cures import cure_of
from bench.stereo.network import NetworkConfig


class _Net:
    weights_path = None


def _assert_weights() -> None:
    assert _Net.weights_path is not None


@pytest.mark.parametrize(
    ("call", "cure"),
    [
        (lambda: torch.load(_Net.weights_path), "stereo.weights=FILE"),  # type: ignore[arg-type]
        (lambda: Path("/not/there/net.pth").read_bytes(), "stereo.weights=FILE"),
        (lambda: torch.load("/not/there/my_net.ckpt"), "stereo.weights=FILE"),
        (_assert_weights, "stereo.weights=FILE"),
        (lambda: torch.nn.Linear(2, 1).load_state_dict({"module.bias": torch.ones(1)}), "fit_state"),
        (lambda: torch.cat([torch.ones(1, 1, 5), torch.ones(1, 1, 6)], 1), "pad_multiple = 32"),
        (lambda: torch.ones(5) + torch.ones(6), "pad_multiple = 32"),
        (lambda: torch.ones(5, requires_grad=True).numpy(), "inference_mode"),
        (lambda: NetworkConfig().wieghts, "Did you mean 'weights'?"),  # type: ignore[attr-defined]
        (lambda: NetworkConfig().zzz, "NetworkConfig has weights, device"),  # type: ignore[attr-defined]
        (lambda: {}["x"], ""),
        (lambda: Path("/not/there/notes.txt").read_text(), ""),
    ],
)
def test_the_cure_of_an_exception(call: Callable[[], object], cure: str) -> None:
    with pytest.raises((Exception, AssertionError)) as caught:
        call()
    found = cure_of(caught.value)  # type: ignore[arg-type]
    assert cure in found
    assert bool(cure) == bool(found)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_cuda_where_there_is_none() -> None:
    with pytest.raises((AssertionError, RuntimeError)) as caught:
        torch.nn.Conv2d(3, 1, 3).cuda()
    assert "leave out .cuda()" in cure_of(caught.value)


@pytest.mark.parametrize(
    ("said", "cure"),
    [
        ("Found no NVIDIA driver on your system. Please check", "leave out .cuda()"),
        ("No CUDA GPUs are available", "leave out .cuda()"),
        ("Attempting to deserialize object on a CUDA device but torch.cuda.is_available() is False.", "map_location"),
        ("Expected all tensors to be on the same device, but found at least two devices", "device=left.device"),
    ],
)
def test_what_torch_says_of_devices(said: str, cure: str) -> None:
    assert cure in cure_of(RuntimeError(said))
