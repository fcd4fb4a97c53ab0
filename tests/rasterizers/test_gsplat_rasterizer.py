"""gsplat on CUDA against the CPU core and the float64 reference; skipped, with the reason, where it can't run."""

from __future__ import annotations

import importlib
import sys
import types
from contextlib import nullcontext
from typing import Any

import pytest
import torch
from random_scenes import GROUPS, SceneSpec, image_gradients, random_scene, relative_l2, render_and_back
from torch import Tensor

from bench import registry
from bench.contracts.rasterizer import Gradients, Rendered
from bench.errors import BenchError
from bench.gaussians.schema import THRESHOLDS
from bench.registry import PluginConfig
from plugins.rasterizers.cpu import CpuRasterizer
from plugins.rasterizers.gsplat import GsplatRasterizer
from plugins.rasterizers.reference import ReferenceRasterizer
from tests.pretended_device import pretended_device

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


@pytest.mark.cuda
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


def _no_driver(name: str) -> None:
    raise OSError(f"{name}: cannot open shared object file")


def test_unavailable_without_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr("plugins.rasterizers.gsplat.importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr("plugins.rasterizers.gsplat.ctypes.CDLL", _no_driver)
    assert "no NVIDIA driver" in str(GsplatRasterizer.unavailable_reason())
    monkeypatch.setattr("plugins.rasterizers.gsplat.ctypes.CDLL", lambda name: None)
    assert "no CUDA device" in str(registry.lookup("rasterizer", "gsplat").unavailable_reason())


def test_unavailable_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr("plugins.rasterizers.gsplat.importlib.util.find_spec", lambda name: None)
    assert "pip install 'bgs-slam-bench[cuda]'" in str(GsplatRasterizer.unavailable_reason())


@pytest.fixture
def gsplat_in_torch(monkeypatch: pytest.MonkeyPatch) -> GsplatRasterizer:
    """Our rasterizer in float64 on the CPU, calling gsplat's own ``rasterization`` with its kernels in torch.

    All that gsplat does in Python is its own: the shapes that it accepts, its axes, the camera's place for the
    harmonics, the depth channel. So is the arithmetic of its kernels: the package has a torch version of each for its
    own tests. Only which pixels a Gaussian reaches, and the sum along a ray (from the package nerfacc there), are ours.
    """
    rendering = pytest.importorskip("gsplat.rendering", reason="gsplat is not installed: pip install -e '.[dev]'")
    kernels = importlib.import_module("gsplat.cuda._torch_impl")

    def project(means: Tensor, covars: None, quats: Tensor, scales: Tensor, *where: Any, **given: Any) -> Any:
        known = {key: given[key] for key in ("eps2d", "near_plane", "far_plane", "camera_model", "calc_compensations")}
        covariances, _ = kernels._quat_scale_to_covar_preci(quats, scales, True, False)
        return kernels._fully_fused_projection(means, covariances, *where, **known)

    def rasterize(
        means: Tensor,
        conics: Tensor,
        channels: Tensor,
        opacities: Tensor,
        width: int,
        height: int,
        *tiles: Any,
        **_: Any,
    ) -> tuple[Tensor, Tensor]:
        reached = tiles[2].unique().long()  # as a flat index of image and Gaussian: there is one image
        order = reached[channels[0, reached, 3].detach().argsort(stable=True)]  # the fourth channel is the depth
        pixels = torch.arange(width * height, device=means.device)
        pairs = order.repeat(len(pixels)), pixels.repeat_interleave(len(order))
        blended = kernels.accumulate(
            means, conics, opacities, channels, *pairs, torch.zeros_like(pairs[0]), width, height
        )
        return blended[0], blended[1]

    def weights(alphas: Tensor, ray_indices: Tensor, n_rays: int) -> tuple[Tensor, None]:
        alpha = torch.where(alphas >= THRESHOLDS.alpha_min, alphas, 0.0).view(n_rays, -1)
        following = torch.cumprod(1.0 - alpha, 1)
        before = torch.cat([torch.ones_like(following[:, :1]), following[:, :-1]], 1)
        return torch.where(following > THRESHOLDS.transmittance_end, alpha * before, 0.0).flatten(), None

    def along_rays(weight: Tensor, values: Tensor | None, ray_indices: Tensor, n_rays: int) -> Tensor:
        summed = weight[:, None] if values is None else weight[:, None] * values
        return summed.view(n_rays, -1, summed.shape[1]).sum(1)

    nerfacc = types.SimpleNamespace(render_weight_from_alpha=weights, accumulate_along_rays=along_rays)
    monkeypatch.setitem(sys.modules, "nerfacc", nerfacc)
    monkeypatch.setattr(rendering, "fully_fused_projection", project)
    monkeypatch.setattr(rendering, "spherical_harmonics", lambda *given, masks: kernels._spherical_harmonics(*given))
    monkeypatch.setattr(rendering, "isect_tiles", lambda *given, **_: kernels._isect_tiles(*given))
    monkeypatch.setattr(rendering, "isect_offset_encode", kernels._isect_offset_encode)
    monkeypatch.setattr(rendering, "rasterize_to_pixels", rasterize)
    mine = GsplatRasterizer(PluginConfig("gsplat"))
    mine.device, mine.precision = torch.device("cpu"), "float64"
    return mine


@pytest.mark.parametrize(("degree", "off_the_cpu"), [(0, False), (1, True), (2, False), (3, False)])
def test_gsplat_in_torch_agrees_with_the_reference(
    gsplat_in_torch: GsplatRasterizer, degree: int, off_the_cpu: bool
) -> None:
    """What we hand to gsplat, and what we read from it: a wrong axis or argument needs no GPU to be found."""
    planes, view = random_scene(SceneSpec(5, 90, 45, 26, 4.0, (0.1, 0.99), degree))
    planes, grads = planes.double(), tuple(g.double() for g in image_gradients(view, 1))
    with pretended_device() if off_the_cpu else nullcontext(torch.device("cpu")) as device:
        gsplat_in_torch.device = device
        given = planes.to(device), view, tuple(g.to(device) for g in grads)
        mine, by_mine = render_and_back(gsplat_in_torch, *given)  # type: ignore[arg-type]
        mine = Rendered(mine.color.cpu(), mine.depth.cpu(), mine.alpha.cpu())
        by_mine = Gradients(by_mine.planes.cpu(), by_mine.touched.cpu(), by_mine.twist.cpu())  # type: ignore[union-attr]
    reference = ReferenceRasterizer(PluginConfig("reference"))
    true, by_true = render_and_back(reference, planes, view, grads)  # type: ignore[arg-type]
    for name in ("color", "depth", "alpha"):
        assert relative_l2(getattr(mine, name), getattr(true, name)) < 1e-6, name
    for group, rows in GROUPS.items():
        assert relative_l2(by_mine.planes[rows], by_true.planes[rows]) < 1e-5, group
    assert relative_l2(by_mine.twist, by_true.twist) < 1e-5  # type: ignore[arg-type]
    # gsplat counts what its box around a Gaussian touches.
    assert bool(by_mine.touched[by_true.touched].all())
    assert not bool(by_mine.touched[::11].any()), "behind the camera"


def test_gsplat_says_why_it_cannot_observe() -> None:
    planes, view = random_scene(SPECS[0])
    with pytest.raises(BenchError, match=r"do not give back a Gaussian's alpha at a pixel. Use mapper.rasterizer=cpu"):
        GsplatRasterizer(PluginConfig("gsplat")).observe(planes, view)


def test_an_empty_map_is_black(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", types.SimpleNamespace(rasterization=None))
    mine = GsplatRasterizer(PluginConfig("gsplat"))
    mine.device = torch.device("cpu")
    _, view = random_scene(SPECS[0])
    rendered, gradients = render_and_back(mine, torch.zeros(14, 0), view, image_gradients(view, 1))
    assert rendered.color.shape == (3, 41, 70)
    assert float(rendered.color.abs().max()) == 0.0
    assert gradients.planes.shape == (14, 0)
