"""Building, loading and calling a published network, in this process, on stand-ins that fail if they download."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from bench.errors import BenchError
from bench.stereo.upstream.construction import patched
from bench.stereo.upstream.model import Motion, UpstreamModel
from bench.stereo.upstream.recipe import UpstreamRecipe
from tests.stereo.fake_upstream import TIMM, recipe_of, write_files

PLAIN = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self, args):
        super().__init__()
        self.layer = nn.Linear(2, 3)

    def forward(self, image1, image2, iters=12, test_mode=False):
        return {output}
"""
HEIGHT, WIDTH = 32, 64


@pytest.fixture(autouse=True)
def _same_path_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))


def checkpoint(path: Path, **changes: torch.Tensor) -> Path:
    state = {"layer.weight": torch.zeros(3, 2), "layer.bias": torch.zeros(3)} | changes
    torch.save({"state_dict": state}, path)
    return path


def loaded(tmp_path: Path, recipe: UpstreamRecipe, file: Path | None = None, **settings: object) -> UpstreamModel:
    options = {"device": "cpu", "trust_pickle": False} | settings
    return UpstreamModel(recipe, tmp_path, file or checkpoint(tmp_path / "net.pth"), **options)  # type: ignore[arg-type]


def images() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    left, right = (rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(2))
    return left, right


@pytest.mark.parametrize(
    ("name", "returned", "output", "sign", "channel"),
    [
        ("positive", "image1[:, :1]", None, 1, 0),
        ("flow", "(image2, -image1[:, 1:2])", 1, -1, 1),
        ("dictionary", "{'flow': -image1[:, 2:]}", "flow", -1, 2),
        ("flat", "image1[:, 0]", None, 1, 0),
    ],
)
def test_output_is_picked_and_signed(
    tmp_path: Path, name: str, returned: str, output: str | int | None, sign: int, channel: int
) -> None:
    write_files(tmp_path, {f"net_{name}.py": PLAIN.replace("{output}", returned)})
    model = loaded(tmp_path, recipe_of(f"net_{name}", "Net", output=output, sign=sign))
    left, right = images()
    disparity = model.match(left, right, iterations=3)
    assert disparity.dtype == np.float32
    np.testing.assert_array_equal(disparity, left[:, :, channel])


@pytest.mark.parametrize(
    ("name", "returned", "output", "told"),
    [
        ("few", "(image1,)", 1, "Net returned a tuple of 1 without 1."),
        ("keys", "{'disp': image1}", "flow", "Net returned a dict with disp without 'flow'."),
        ("shape", "image1", None, "Net returned a tensor (1, 3, 32, 64); expected a tensor (1, 1, 32, 64)."),
    ],
)
def test_other_output_than_the_recipes(
    tmp_path: Path, name: str, returned: str, output: str | int | None, told: str
) -> None:
    write_files(tmp_path, {f"odd_{name}.py": PLAIN.replace("{output}", returned)})
    model = loaded(tmp_path, recipe_of(f"odd_{name}", "Net", output=output))
    with pytest.raises(BenchError) as error:
        model.match(*images(), iterations=3)
    assert str(error.value) == f"{told} Use a checkout of https://example.org/net at commit 0123456789."


def test_checkpoint_of_another_network_names_the_keys(tmp_path: Path) -> None:
    write_files(tmp_path, {"net_keys.py": PLAIN.replace("{output}", "image1")})
    other = tmp_path / "other.pth"
    torch.save({"module.layer.weight": torch.zeros(4, 2), "module.head.bias": torch.zeros(1)}, other)
    with pytest.raises(BenchError) as error:
        loaded(tmp_path, recipe_of("net_keys", "Net"), other)
    text = str(error.value)
    assert f"{other} does not fit Net" in text
    assert "1 missing (layer.bias)" in text
    assert "1 unexpected (head.bias)" in text
    assert "layer.weight: file (4, 2), network (3, 2)" in text


class RunsCode(nn.Linear):
    """A layer whose pickle is a whole object."""


def test_pickled_network_is_read_only_when_trusted(tmp_path: Path) -> None:
    write_files(tmp_path, {"net_pickle.py": PLAIN.replace("{output}", "image1[:, :1] * 0 + self.layer.bias[1]")})
    layer = RunsCode(2, 3)
    nn.init.constant_(layer.bias, 4.5)
    whole = nn.Module()
    whole.layer = layer
    file = tmp_path / "whole.pth"
    torch.save({"model": whole}, file)
    recipe = recipe_of("net_pickle", "Net")
    with pytest.raises(BenchError, match=r"holds a pickled Python object .* stereo\.trust_pickle=true") as error:
        loaded(tmp_path, recipe, file)
    assert isinstance(error.value.__cause__.__cause__, pickle.UnpicklingError)  # type: ignore[union-attr]
    left, right = images()
    disparity = loaded(tmp_path, recipe, file, trust_pickle=True).match(left, right, iterations=3)
    np.testing.assert_array_equal(disparity, np.full((HEIGHT, WIDTH), 4.5, np.float32))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is CUDA here")
def test_without_cuda(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"stereo\.device=cuda: torch finds no CUDA device here"):
        loaded(tmp_path, recipe_of("never_imported", "Net"), device="cuda")
    mixed = recipe_of("never_imported", "Net", arguments={"mixed_precision": True})
    with pytest.raises(BenchError, match=r"stereo\.dtype=float16 needs CUDA for Net"):
        loaded(tmp_path, mixed)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("absent_class", "", r"Net can't be built from .*: AttributeError: .* has no attribute 'Net'"),
        (
            "raises",
            "def Net(args):\n    raise ValueError('bad args')",
            r"ValueError: bad args \(line 2 of .*raises\.py\)",
        ),
        ("argument", "def Net(args):\n    return args.encoder", r"the recipe has no constructor argument 'encoder'"),
        ("no_network", "def Net(args):\n    return 1", r"Net of .*no_network\.py is no torch network"),
        (
            "dependency",
            "import no_such_package.part",
            r"needs the Python module 'no_such_package', which .* pip install",
        ),
        (
            "download",
            "import torch\ndef Net(args):\n    torch.hub.load_state_dict_from_url('https://x.org/w.pth')",
            r"tries to download https://x\.org/w\.pth",
        ),
    ],
)
def test_checkout_that_can_not_be_built(tmp_path: Path, name: str, text: str, told: str) -> None:
    write_files(tmp_path, {f"{name}.py": text})
    with pytest.raises(BenchError, match=told):
        loaded(tmp_path, recipe_of(name, "Net"))


def test_incomplete_checkout(tmp_path: Path) -> None:
    write_files(tmp_path, {"part_core/net.py": "import part_core.update"})
    with pytest.raises(BenchError, match=r"has no module part_core\.update\. Is the checkout of .* complete\?"):
        loaded(tmp_path, recipe_of("part_core.net", "Net"))


def test_timm_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(BenchError, match=r"Net needs the Python module 'timm', which .* pip install --no-deps timm`"):
        loaded(tmp_path, recipe_of("never_imported", "Net", patches=("timm",)))


def test_timm_builds_without_weights_and_has_act1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_files(tmp_path / "site", {"timm/__init__.py": TIMM})
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.delitem(sys.modules, "timm", raising=False)
    with patched(("timm",), (), tmp_path):
        import timm

        assert isinstance(timm.create_model("new", pretrained=True, features_only=True).act1, nn.Identity)
        assert isinstance(timm.create_model("old", pretrained=True).act1, nn.ReLU6)
        # Without an activation anywhere, none is invented.
        assert not hasattr(timm.create_model("bare", pretrained=True), "act1")
    with pytest.raises(AssertionError, match="a download"):
        timm.create_model("new", pretrained=True)
    monkeypatch.delitem(sys.modules, "timm")


def test_dinov2_comes_from_the_checkout(tmp_path: Path) -> None:
    hubconf = (
        "from torch.nn import Linear\ndef dinov2_vitl14(pretrained):\n    return None if pretrained else Linear(2, 5)"
    )
    write_files(tmp_path, {"dinov2/hubconf.py": hubconf})
    with patched(("dinov2",), (), tmp_path):
        model = torch.hub.load("facebookresearch/dinov2", "dinov2_vitl14", pretrained=False)
        with pytest.raises(RuntimeError, match="fetch someone/else from torch's hub"):
            torch.hub.load("someone/else", "net")
    assert model.weight.shape == (5, 2)


def test_depth_anything_file_is_not_needed(tmp_path: Path) -> None:
    layer, before = nn.Linear(2, 2), nn.Linear(2, 2)
    before.load_state_dict(layer.state_dict())
    torch.save({"weight": torch.ones(2, 2), "bias": torch.ones(2)}, tmp_path / "other.pth")
    with patched(("depth_anything",), (), tmp_path):
        layer.load_state_dict(torch.load("./pretrained/depth_anything_v2_vitl.pth", map_location="cpu"), strict=True)
        assert torch.equal(layer.weight, before.weight)
        layer.load_state_dict(torch.load(tmp_path / "other.pth"))
    assert torch.equal(layer.weight, torch.ones(2, 2))
    with pytest.raises(FileNotFoundError):
        torch.load("./pretrained/depth_anything_v2_vitl.pth")


def test_torchvision_can_be_imported() -> None:
    with patched(("torchvision",), (), Path()):
        import torchvision
    normalised = torchvision.transforms.Normalize([0.5], [0.25])(torch.full((1, 2, 2), 0.75))
    assert torch.equal(normalised, torch.ones(1, 2, 2))


def test_stand_ins_replace_only_what_is_missing() -> None:
    with patched((), ("stand_in_for_tests", "json"), Path()):
        namespace: dict[str, object] = {}
        exec("import stand_in_for_tests as s\nfrom stand_in_for_tests import *\ns.io.Cloud\nimport json", namespace)
        assert namespace["json"].loads("1") == 1  # type: ignore[attr-defined]
    del sys.modules["stand_in_for_tests"]


TEMPORAL = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self, args):
        super().__init__()
        self.layer = nn.Linear(2, 3)
        self.seen = []

    def forward(self, image1, image2, iters=12, params=None, test_mode=False, frame_id=0):
        self.seen.append(params)
        made = {key: torch.rand(1) for key in ("flow_q", "fmap1")}
        return {"flow": -image1[:, :1], "net_list": [torch.rand(1)] * 3} | made
"""


def test_temporal_network_gets_what_it_returned(tmp_path: Path) -> None:
    write_files(tmp_path, {"net_temporal.py": TEMPORAL})
    model = loaded(tmp_path, recipe_of("net_temporal", "Net", output="flow", sign=-1))
    outputs: list[dict[str, torch.Tensor]] = []
    model._network.register_forward_hook(lambda module, given, output: outputs.append(output))
    seen = model._network.seen
    K, T = np.diag([700.0, 710.0, 1.0]), np.eye(4)
    T[2, 3] = -0.8
    first, moved = Motion(K, 0.54, None), Motion(K, 0.54, T)
    left, right = images()
    # The second frame, a mirrored pair in between that must leave no trace, the third frame, a new beginning.
    for motion in (first, moved, None, moved, first):
        model.match(left, right, 3, motion)
    assert [params is None for params in seen] == [True, False, True, False, True]
    for params, before in ((seen[1], outputs[0]), (seen[3], outputs[1])):
        assert params["last_disp"] is before["flow_q"]
        assert params["last_net_list"] is before["net_list"]
        assert params["fmap1"] is before["fmap1"]
        assert params["K"].shape == (1, 3, 3)
        assert params["baseline"].shape == (1,)
        assert params["baseline"].item() == pytest.approx(0.54)
        # Poses are world to camera; the authors use T inv(previous_T).
        relative = (params["T"] @ torch.linalg.inv(params["previous_T"]))[0].double().numpy()
        np.testing.assert_allclose(relative, T, atol=1e-7)
