"""gsplat on CUDA against the CPU core and the float64 reference; skipped, with the reason, where it can't run."""

from __future__ import annotations

import sys
import types
from typing import Any

import numpy as np
import pytest
import torch
from random_scenes import GROUPS, SceneSpec, image_gradients, random_scene, relative_l2, render_and_back
from torch import Tensor

from bench import registry
from bench.errors import BenchError
from bench.gaussians.spherical_harmonics import basis
from bench.registry import PluginConfig
from bench.types import PinholeView
from plugins.rasterizers.cpu import CpuRasterizer
from plugins.rasterizers.gsplat import GsplatRasterizer
from plugins.rasterizers.reference import ReferenceRasterizer

SPECS = [
    SceneSpec(1, 203, 70, 41, 1.2, (0.05, 0.5)),
    SceneSpec(2, 150, 97, 50, 6.0, (0.1, 0.99)),
    SceneSpec(3, 150, 97, 50, 3.0, (0.1, 0.9), degree=1),
    SceneSpec(4, 150, 97, 50, 3.0, (0.1, 0.9), degree=3),
]


@pytest.fixture
def gsplat() -> GsplatRasterizer:
    reason = GsplatRasterizer.unavailable_reason()
    if reason is not None:
        pytest.skip(reason)
    return GsplatRasterizer(PluginConfig("gsplat"))


@pytest.mark.parametrize("spec", SPECS)
def test_images_and_gradients_agree(gsplat: GsplatRasterizer, spec: SceneSpec) -> None:
    planes, view = random_scene(spec)
    grads = image_gradients(view, 1)
    on_gpu = tuple(g.to(gsplat.device) for g in grads)
    mine, by_mine = render_and_back(gsplat, planes.to(gsplat.device), view, on_gpu)  # type: ignore[arg-type]
    others = (CpuRasterizer(PluginConfig("cpu")), ReferenceRasterizer(PluginConfig("reference")))
    for other in others:
        true, by_true = render_and_back(other, planes, view, grads)
        for name in ("color", "depth", "alpha"):
            error = (getattr(mine, name).cpu() - getattr(true, name)).abs().flatten()
            assert float(error.quantile(0.99)) < 1e-4, name
        for group, rows in GROUPS.items():
            assert relative_l2(by_mine.planes[rows].cpu(), by_true.planes[rows]) < 1e-2, group
        assert by_mine.twist is not None
        assert by_true.twist is not None
        assert relative_l2(by_mine.twist.cpu(), by_true.twist) < 1e-2


def test_unavailable_without_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr("plugins.rasterizers.gsplat.importlib.util.find_spec", lambda name: object())
    assert "no CUDA device" in str(registry.lookup("rasterizer", "gsplat").unavailable_reason())


def test_unavailable_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr("plugins.rasterizers.gsplat.importlib.util.find_spec", lambda name: None)
    assert "pip install 'bgs-slam-bench[cuda]'" in str(GsplatRasterizer.unavailable_reason())


@pytest.mark.parametrize("spec", SPECS[1:])
def test_what_is_handed_to_gsplat(monkeypatch: pytest.MonkeyPatch, spec: SceneSpec) -> None:
    """Without a GPU: a stand-in paints, by our float64 reference, what gsplat would be given.

    So activations, pixel centres, axes, the pose and its gradients are right if the images are those of the reference.
    """
    reference = ReferenceRasterizer(PluginConfig("reference"))

    def stand_in(**given: Any) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        assert (given["near_plane"], given["eps2d"], given["render_mode"]) == (0.2, 0.3, "RGB+D")
        K, T = given["Ks"][0], given["viewmats"][0]
        # World points and axes moved to the camera's frame by what was given, then seen from the identity.
        focal_and_center = (float(v) for v in (K[0, 0], K[1, 1], K[0, 2] - 0.5, K[1, 2] - 0.5))
        view = PinholeView(np.eye(4), *focal_and_center, given["width"], given["height"])
        w, x, y, z = given["quats"].T
        rows = [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
        rotation = torch.stack(rows, 1).view(-1, 3, 3)
        M = T[:3, :3] @ rotation * given["scales"][:, None, :]
        monkeypatch.setattr(reference, "_image_covariance", lambda p, R, p_cam, z, v: _covariance(M, p_cam, z, v))
        means = given["means"] @ T[:3, :3].T + T[:3, 3]
        logits, colors = torch.logit(given["opacities"]), (_colors(**given) - 0.5) / 0.28209479177387814
        planes = torch.cat([means.T, torch.zeros(7, len(means), dtype=means.dtype), logits[None], colors.T])
        color, depth, alpha, visible = reference.splat(planes, view, torch.zeros(6, dtype=means.dtype))
        images = torch.cat([color, depth[None]]).permute(1, 2, 0)
        return images[None], alpha[None, ..., None], {"radii": visible[None, :, None].expand(1, -1, 2).int()}

    monkeypatch.setitem(sys.modules, "gsplat", types.SimpleNamespace(rasterization=stand_in))
    mine = GsplatRasterizer(PluginConfig("gsplat"))
    mine.device, mine.precision = torch.device("cpu"), "float64"
    planes, view = random_scene(spec)
    planes, grads = planes.double(), tuple(g.double() for g in image_gradients(view, 1))
    rendered, gradients = render_and_back(mine, planes, view, grads)  # type: ignore[arg-type]
    monkeypatch.undo()
    true, by_true = render_and_back(ReferenceRasterizer(PluginConfig("reference")), planes, view, grads)  # type: ignore[arg-type]
    for name in ("color", "depth", "alpha"):
        assert relative_l2(getattr(rendered, name), getattr(true, name)) < 1e-6, name
    assert relative_l2(gradients.planes, by_true.planes) < 1e-5
    assert relative_l2(gradients.twist, by_true.twist) < 1e-5  # type: ignore[arg-type]
    assert torch.equal(gradients.touched, by_true.touched)


def _colors(colors: Tensor, means: Tensor, viewmats: Tensor, sh_degree: int | None, **_: Any) -> Tensor:
    """RGB (N, 3): as given, or from coefficients (N, K, 3), as gsplat documents ``sh_degree``."""
    if sh_degree is None:
        return colors
    assert colors.shape == (len(means), (sh_degree + 1) ** 2, 3)
    directions = torch.nn.functional.normalize(means - torch.inverse(viewmats[0])[:3, 3], dim=1)
    return (0.5 + (basis(directions, sh_degree)[..., None] * colors).sum(1)).clamp_min(0.0)


def test_gsplat_says_why_it_cannot_observe() -> None:
    planes, view = random_scene(SPECS[0])
    with pytest.raises(BenchError, match=r"do not give back a Gaussian's alpha at a pixel. Use mapper.rasterizer=cpu"):
        GsplatRasterizer(PluginConfig("gsplat")).observe(planes, view)


def _covariance(M: Tensor, p_cam: Tensor, z: Tensor, view: PinholeView) -> Tensor:
    """The reference's projected covariance for axes M (N, 3, 3) that are in the camera's frame already."""
    margin_x, margin_y = 0.15 * view.width / view.fx, 0.15 * view.height / view.fy
    right, bottom = (view.width - view.cx - 0.5) / view.fx, (view.height - view.cy - 0.5) / view.fy
    rx = (p_cam[:, 0] / z).clamp(-((view.cx + 0.5) / view.fx + margin_x), right + margin_x)
    ry = (p_cam[:, 1] / z).clamp(-((view.cy + 0.5) / view.fy + margin_y), bottom + margin_y)
    zero = torch.zeros_like(z)
    J = torch.stack([view.fx / z, zero, -view.fx * rx / z, zero, view.fy / z, -view.fy * ry / z], 1).view(-1, 2, 3)
    A = J @ M
    return A @ A.transpose(1, 2) + 0.3 * torch.eye(2, dtype=M.dtype)


def test_an_empty_map_is_black(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", types.SimpleNamespace(rasterization=None))
    mine = GsplatRasterizer(PluginConfig("gsplat"))
    mine.device = torch.device("cpu")
    _, view = random_scene(SPECS[0])
    rendered, gradients = render_and_back(mine, torch.zeros(14, 0), view, image_gradients(view, 1))
    assert rendered.color.shape == (3, 41, 70)
    assert float(rendered.color.abs().max()) == 0.0
    assert gradients.planes.shape == (14, 0)
