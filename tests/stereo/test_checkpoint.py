"""Checkpoints in the layouts that training scripts leave, and the ones that do not fit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from bench.errors import BenchError
from bench.stereo.checkpoint import fit_state, load_state


class TwoLayers(nn.Module):
    """The network to load."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(3, 4, 3)
        self.norm = nn.BatchNorm2d(4)


LAYOUTS: dict[str, Callable[[dict[str, Tensor]], object]] = {
    "plain": lambda state: state,
    "data parallel": lambda state: {f"module.{key}": value for key, value in state.items()},
    "wrapped": lambda state: {"epoch": 3, "state_dict": state, "optimizer": {"lr": 0.1}},
    "wrapped and parallel": lambda state: {"model": {f"module.{key}": value for key, value in state.items()}},
    "before the counter": lambda state: {k: v for k, v in state.items() if not k.endswith("num_batches_tracked")},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_known_layouts(layout: str, tmp_path: Path) -> None:
    source, target = TwoLayers(), TwoLayers()
    file = tmp_path / "net.pth"
    torch.save(LAYOUTS[layout](source.state_dict()), file)
    fit_state(target, load_state(file), file)
    assert torch.equal(source.first.weight, target.first.weight)


def test_a_network_whose_part_is_called_module(tmp_path: Path) -> None:
    """Only a prefix that all keys have is that of data-parallel training."""
    file = tmp_path / "net.pth"
    torch.save({"module.weight": torch.zeros(1), "head.weight": torch.zeros(1)}, file)
    assert set(load_state(file)) == {"module.weight", "head.weight"}


def test_misfit_counts_and_names_the_keys(tmp_path: Path) -> None:
    state = TwoLayers().state_dict()
    for key in ("norm.weight", "norm.bias", "norm.running_mean", "norm.running_var"):
        del state[key]
    state["first.weight"] = torch.zeros(4, 1, 3, 3)
    state["head.weight"] = torch.zeros(1)
    with pytest.raises(BenchError) as raised:
        fit_state(TwoLayers(), state, tmp_path / "net.pth")
    assert str(raised.value) == (
        f"The checkpoint {tmp_path}/net.pth does not fit TwoLayers: of 7 keys 4 missing (norm.weight, norm.bias, "
        "norm.running_mean, ...), 1 unexpected (head.weight), 1 of another shape (first.weight: file (4, 1, 3, 3), "
        "network (4, 3, 3, 3)). Is it of another network, or of other settings?"
    )


def test_a_misfit_changes_nothing() -> None:
    network = TwoLayers()
    before = network.first.weight.clone()
    with pytest.raises(BenchError):
        fit_state(network, {"first.weight": torch.zeros(4, 3, 3, 3)}, Path("net.pth"))
    assert torch.equal(network.first.weight, before)


def test_parts_that_the_network_does_without(tmp_path: Path) -> None:
    state = {**TwoLayers().state_dict(), "refine.weight": torch.zeros(1)}
    fit_state(TwoLayers(), state, tmp_path / "net.pth", ignore=("refine.",))


def test_a_pickled_network_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "net.pth"
    torch.save(TwoLayers(), file)
    with pytest.raises(BenchError, match=r"holds a pickled Python object \(\S*TwoLayers\).* would run code"):
        load_state(file)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "can't be read: it is damaged"),
        (b"PK\x03\x04 no archive", "can't be read: it is damaged"),
        (b"<html>quota exceeded</html>", "can't be read: it is damaged, or no file of torch.save"),
    ],
)
def test_files_that_are_no_checkpoints(content: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "net.pth"
    file.write_bytes(content)
    with pytest.raises(BenchError, match=message):
        load_state(file)


def test_a_file_without_tensors(tmp_path: Path) -> None:
    file = tmp_path / "net.pth"
    torch.save({"epoch": 3, "loss": 0.1}, file)
    with pytest.raises(BenchError, match=r"holds a dict with the keys epoch, loss, but no tensors by name"):
        load_state(file)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"net\.pth does not exist\. Correct the path"):
        load_state(tmp_path / "net.pth")
