"""Random Gaussian scenes for comparing rasterizers, and how two sets of gradients are compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from bench.contracts.rasterizer import Gradients, Rasterizer, Rendered
from bench.gaussians.parameters import planes_from
from bench.gaussians.schema import COLOR, HARMONICS, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, planes_of
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor

GROUPS = {
    "means": MEAN,
    "log scales": LOG_SCALE,
    "quaternions": QUATERNION,
    "opacity": slice(OPACITY_LOGIT, OPACITY_LOGIT + 1),
    "colors": COLOR,
    "harmonics": HARMONICS,
}


@dataclass(frozen=True)
class SceneSpec:
    """What a random scene looks like; ``ratio`` is longest to shortest axis, ``opacity`` the range it is drawn from,
    ``degree`` that of the spherical harmonics."""

    seed: int
    count: int
    width: int
    height: int
    ratio: float
    opacity: tuple[float, float]
    degree: int = 0


def random_view(rng: np.random.Generator, width: int, height: int) -> PinholeView:
    """A camera with a slightly turned and shifted pose and a principal point off the middle."""
    T = torch.eye(4, dtype=torch.float64)
    cross = torch.zeros(4, 4, dtype=torch.float64)
    a, b, c = rng.normal(0, 0.1, 3)
    cross[:3, :3] = torch.tensor([[0, -c, b], [c, 0, -a], [-b, a, 0]], dtype=torch.float64)
    T = torch.matrix_exp(cross) @ T
    T[:3, 3] = torch.from_numpy(rng.normal(0, 0.2, 3))
    focal = 0.8 * width
    return PinholeView(T.numpy(), focal, 1.05 * focal, 0.47 * width, 0.55 * height, width, height)


def random_scene(spec: SceneSpec) -> tuple[Tensor, PinholeView]:
    """(P, N) float32 parameters and a view: most are in view, some straddle a border, some lie behind the camera."""
    rng = np.random.default_rng(spec.seed)
    view = random_view(rng, spec.width, spec.height)
    n = spec.count
    z = rng.uniform(1.5, 9.0, n)
    # Up to 30 % beyond each border, where the clamp of the Jacobian acts.
    u, v = rng.uniform(-0.3, 1.3, n) * spec.width, rng.uniform(-0.3, 1.3, n) * spec.height
    in_camera = np.stack([(u - view.cx) / view.fx * z, (v - view.cy) / view.fy * z, z], 1)
    in_camera[::11] *= -1.0  # behind the camera
    means = in_camera @ view.T_world_cam[:3, :3].T + view.T_world_cam[:3, 3]
    pixels = rng.uniform(1.0, 4.0, n)
    sigma = pixels * z / view.fx
    axes = sigma[:, None] * np.stack([np.ones(n), rng.uniform(0.8, 1.0, n), np.full(n, 1 / spec.ratio)], 1)
    quaternions = rng.normal(size=(n, 4)) * rng.uniform(0.5, 2.0, (n, 1))  # not of unit length
    opacities = rng.uniform(*spec.opacity, n)
    colors = rng.uniform(-0.15, 1.1, (n, 3))  # some below zero, where the colour is clamped
    arrays = (means, axes, quaternions, opacities, colors)
    planes = planes_from(*(torch.from_numpy(np.asarray(a, np.float32)) for a in arrays))
    harmonics = rng.normal(0.0, 0.4, (planes_of(spec.degree) - len(planes), n)).astype(np.float32)
    return torch.cat([planes, torch.from_numpy(harmonics)]), view


def image_gradients(view: PinholeView, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Made-up gradients of a loss by colour, depth and alpha."""
    rng = np.random.default_rng(seed)
    shapes = ((3, view.height, view.width), (view.height, view.width), (view.height, view.width))
    return tuple(torch.from_numpy(rng.normal(size=s).astype(np.float32)) for s in shapes)  # type: ignore[return-value]


def relative_l2(value: Tensor, truth: Tensor) -> float:
    """|value - truth| / |truth|; 0 where both are zero."""
    difference, size = float((value.double() - truth.double()).norm()), float(truth.double().norm())
    return 0.0 if difference == 0.0 else difference / max(size, 1e-300)


def render_and_back(
    rasterizer: Rasterizer, planes: Tensor, view: PinholeView, grads: tuple[Tensor, Tensor, Tensor], pose: bool = True
) -> tuple[Rendered, Gradients]:
    """One forward and one backward pass; gradients are zero where nothing was touched."""
    rendered = rasterizer.render(planes, view)
    gradients = rasterizer.backward(rendered, *grads, pose=pose)
    return rendered, replace(gradients, planes=gradients.dense())
