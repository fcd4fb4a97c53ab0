"""Checkpoints in the layouts that training scripts leave, and the ones that do not fit."""

from __future__ import annotations

import zipfile
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
    "another key": lambda state: {
        "epoch": 3,
        "teacher": state,
        "optimizer": {"state": {0: {"exp_avg": torch.ones(1)}}},
    },
    "two keys deep": lambda state: {"checkpoint": {"net": state, "ema": state}},
    "Lightning": lambda state: {"state_dict": {f"model.{key}": value for key, value in state.items()}},
    "compiled": lambda state: {"net": {f"module._orig_mod.{key}": value for key, value in state.items()}},
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
        (b"", r"can't be read: it is empty\. Fetch it again"),
        (b"PK\x03\x04 no archive", "can't be read: it is damaged, or no file of torch.save"),
        (b"<html>quota exceeded</html>", r"it is a web page \(HTML\), .* save the file itself"),
        (b"\xef\xbb\xbf\n<!DOCTYPE HTML>\n<title>Sign in", r"it is a web page \(HTML\)"),
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 1234567890\n",
            r"it is a Git LFS pointer to a file of 1,235 MB, .* Run `git lfs pull`",
        ),
        (b'{"error": "Repository is gated"}\n', r"it is text, which begins '{\"error\": \"Repository is gated\"}"),
        (b"\x1f\x8b\x08\x00 packed", r"it is a gzip archive\. Unpack it"),
        (bytes(257) + b"ustar\x00" + bytes(300), r"it is a tar archive\. Unpack it"),
        (b"\x02" + bytes(7) + b"{}" + bytes(8), r"it is a safetensors file\. Save it with torch\.save"),
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


def test_two_sets_of_tensors_are_not_guessed_between(tmp_path: Path) -> None:
    file = tmp_path / "net.pth"
    torch.save({"student": {"a": torch.ones(1)}, "teacher": {"a": torch.ones(1)}}, file)
    with pytest.raises(BenchError, match=r"several sets of tensors \(student, teacher\)\. Save the one"):
        load_state(file)


def test_an_archive_with_a_checkpoint_inside(tmp_path: Path) -> None:
    file = tmp_path / "net.zip"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("weights/net.pth", b"x")
    with pytest.raises(BenchError, match=r"it is a zip archive\. Unpack it, and give the file of weights inside"):
        load_state(file)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"net\.pth does not exist\. Correct the path"):
        load_state(tmp_path / "net.pth")
