"""Small stand-ins for the authors' repositories, with their calling conventions. No test: the tests write them to disk.

Each has a package ``core``, a class that takes one object of arguments, and asserts on what a published network relies
on: colours from 0 to 255 as float32, sides that are multiples of 32, ``test_mode=True``. What they return is a simple
function of their input, so that a wrong channel, side, sign, padding or iteration count changes the number.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from bench.stereo.upstream.recipe import UpstreamRecipe

CHECKS = """
import os
import torch
from torch import nn

def check(image1, image2, test_mode):
    assert test_mode
    assert image1.dtype == torch.float32 and image1.shape == image2.shape
    assert image1.shape[1] == 3 and image1.shape[2] % 32 == 0 and image1.shape[3] % 32 == 0
    if image1[0, 0, 0, 0] == 255:
        os._exit(7)
"""

IGEV = """
from core.checks import check, nn, torch
from core.which import WHICH
import timm
print("authors print at import")

class IGEVStereo(nn.Module):
    def __init__(self, args):
        super().__init__()
        assert args.max_disp == 192 and args["hidden_dims"] == [128, 128, 128] and args.get("nothing") is None
        assert isinstance(timm.create_model("new", pretrained=True, features_only=True).act1, nn.Identity)
        self.gain = nn.Parameter(torch.zeros(1))
        self.norm = nn.BatchNorm2d(3)

    def forward(self, image1, image2, iters=12, flow_init=None, test_mode=False):
        check(image1, image2, test_mode)
        assert WHICH == "igev" and not self.training
        # Left red minus right green: the order of images and channels shows in the number.
        return self.gain * (image1[:, :1] - image2[:, 1:2]) + iters
"""

TIMM = """
from torch import nn

class Activated(nn.BatchNorm2d):
    def __init__(self):
        super().__init__(2)
        self.act = nn.ReLU6()

def create_model(name, pretrained=False, features_only=False):
    assert not pretrained, "a download"
    model = nn.Module()
    model.bn1 = Activated() if name == "new" else nn.BatchNorm2d(2)
    if name == "old":
        model.act1 = nn.ReLU6()
    return model
"""

TCSM = """
from core.checks import check, nn, torch
from core.which import WHICH
from core.utils.splatting.softsplat import softsplat_func

class TCStereo(nn.Module):
    def __init__(self, args):
        super().__init__()
        assert args.context_norm == "none" and args.shared_backbone and not args.mixed_precision
        self.gain = nn.Parameter(torch.zeros(1))
        self.seen = []

    def forward(self, image1, image2, iters=12, params=None, test_mode=False, frame_id=0):
        check(image1, image2, test_mode)
        assert WHICH == "tcsm" and iters == 5
        self.seen.append(params)
        disparity = torch.full_like(image1[:, :1], 20.0) * self.gain
        if params is not None:
            assert (params["last_disp"] < 0).all() and len(params["last_net_list"]) == 3
            step = params["T"] @ torch.linalg.inv(params["previous_T"])
            disparity = disparity + 10 + step[0, 2, 3]
        quarter = torch.nn.functional.avg_pool2d(disparity, 4) / 4
        splat = softsplat_func.apply(quarter, torch.zeros_like(quarter).repeat(1, 2, 1, 1))
        assert torch.equal(splat, quarter)
        return {"flow": -disparity, "flow_q": -quarter, "net_list": [quarter] * 3, "fmap1": quarter}
"""

SOFTSPLAT = """
import cupy

@cupy.memoize(for_each_device=True)
def cuda_launch(key):
    return cupy.cuda.compile_with_cache(key)

class softsplat_func:
    @staticmethod
    def apply(values, flow):
        raise AssertionError("only on CUDA")
"""


def write_files(root: Path, files: dict[str, str]) -> Path:
    """Write ``files`` (path: text) below ``root``, which is returned."""
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def igev_checkout(root: Path) -> Path:
    """As the authors': the package is in the folder IGEV-Stereo of the repository."""
    write_files(
        root / "IGEV-Stereo",
        {
            "core/__init__.py": "",
            "core/checks.py": CHECKS,
            "core/which.py": "WHICH = 'igev'",
            "core/igev_stereo.py": IGEV,
            # Here it is found before an installed one.
            "timm/__init__.py": TIMM,
        },
    )
    return root


def tcsm_checkout(root: Path) -> Path:
    """As the authors': the package at the top, and a CUDA kernel that needs cupy."""
    return write_files(
        root,
        {
            "core/__init__.py": "",
            "core/checks.py": CHECKS,
            "core/which.py": "WHICH = 'tcsm'",
            "core/tc_stereo.py": TCSM,
            "core/utils/splatting/softsplat.py": SOFTSPLAT,
        },
    )


def igev_checkpoint(path: Path, gain: float = 2.0) -> Path:
    """Flat, with the prefix of data-parallel training."""
    norm = {key: torch.ones(3) for key in ("weight", "bias", "running_mean", "running_var")}
    state = {"gain": torch.tensor([gain])} | {f"norm.{key}": value for key, value in norm.items()}
    state["norm.num_batches_tracked"] = torch.tensor(3)
    torch.save({f"module.{key}": value for key, value in state.items()}, path)
    return path


def tcsm_checkpoint(path: Path) -> Path:
    """Under ``model``, without a prefix."""
    torch.save({"model": {"gain": torch.ones(1)}, "step": 5}, path)
    return path


def recipe_of(module: str, class_name: str, **settings: Any) -> UpstreamRecipe:
    """A recipe without arguments, for a module of any name, so that several can be imported in one process."""
    return UpstreamRecipe(
        title="Net",
        repository="https://example.org/net",
        tested_commit="0123456789abcdef",
        weights="igev_kitti2015",
        module=module,
        class_name=class_name,
        arguments=settings.pop("arguments", {}),
        iterations=3,
        **settings,
    )
