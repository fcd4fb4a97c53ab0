"""How MonoGS's map gets denser where it errs, and what it removes: 3DGS's rules with MonoGS's thresholds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from bench.contracts.rasterizer import Gradients
from bench.gaussians.map import GaussianMap
from bench.gaussians.parameters import NamedParameters
from bench.gaussians.schema import LOG_SCALE, MEAN, OPACITY_LOGIT, THRESHOLDS
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor

_CHILDREN, _SHRINK = 2, 1.6
_SIGMAS = 3.0


@dataclass(frozen=True)
class DensityRules:
    """What is cloned, split and removed; lengths are standard deviations along the longest axis."""

    gradient: float
    """Clone or split from this mean gradient of the loss by the place in the image on, in half images."""
    clone_below_m: float
    """Clone what is no larger, split what is."""
    least_opacity: float
    most_m: float
    """Remove what is larger; infinity: nothing is too large."""
    most_px: float
    """Remove what spans more pixels (three standard deviations) in a view; infinity: nothing does."""


class ImageGradients:
    """Sums, over views, of the length of the loss's gradient by a Gaussian's place in the image, in half images."""

    def __init__(self, device: torch.device) -> None:
        self._sum, self._views = torch.zeros(0, device=device), torch.zeros(0, device=device)

    def reset(self, count: int) -> None:
        """Begin anew for so many Gaussians."""
        self._sum, self._views = self._sum.new_zeros(count), self._sum.new_zeros(count)

    def add(self, planes: Tensor, view: PinholeView, gradients: Gradients) -> None:
        """A view of the (P, N) parameters, and the gradients of its loss.

        Rasterizers give the gradient by the place in the world: with x_px = f x / z + c, that by x_px is z / f times
        the one by the camera's x (of which the part that comes by the change of shape is not taken off).
        """
        if len(self._sum) != planes.shape[1]:
            raise AssertionError("reset() comes after Gaussians have come or gone")
        T = torch.from_numpy(view.T_cam_world).to(planes)
        z = (T[2, :3] @ planes[MEAN] + T[2, 3]) / 2
        by_x, by_y = T[:2, :3] @ gradients.planes[MEAN]
        length = torch.hypot(by_x.mul_(view.width / view.fx), by_y.mul_(view.height / view.fy)).mul_(z)
        self._sum += torch.where(gradients.touched, length, 0.0)
        self._views += gradients.touched

    def means(self) -> Tensor:
        """(N,) mean over the views that saw a Gaussian; 0 for one that none did."""
        return self._sum / self._views.clamp_min(1)


def densify_and_prune(
    gaussians: GaussianMap,
    gradients: Tensor,
    rules: DensityRules,
    views: Iterable[PinholeView],
    random: np.random.Generator,
) -> tuple[int, int]:
    """Apply the rules; ``gradients`` (N,) are the means of ``ImageGradients``, ``views`` where sizes in the image are
    looked at. How many Gaussians came and went."""
    before, planes = len(gaussians), gaussians.planes
    largest = planes[LOG_SCALE].amax(0).exp() if before else planes.new_zeros(0)
    erring, small = gradients >= rules.gradient, largest <= rules.clone_below_m
    cloned, split = torch.nonzero(erring & small)[:, 0], torch.nonzero(erring & ~small)[:, 0]
    parents = torch.cat([cloned, split.repeat(_CHILDREN)])
    if len(parents):
        children = torch.cat([planes[:, cloned], _halves(planes[:, split.repeat(_CHILDREN)], random)], 1)
        gaussians.replace(erring & ~small, children, parents)
    after, planes = len(gaussians), gaussians.planes
    gone = torch.sigmoid(planes[OPACITY_LOGIT]) < rules.least_opacity
    gone |= planes[LOG_SCALE].exp().amax(0) > rules.most_m if after else gone
    if np.isfinite(rules.most_px):
        for view in views:
            gone |= screen_radius(planes, view) > rules.most_px
    if bool(gone.any()):
        gaussians.keep(~gone)
    return after - before + len(split), after - len(gaussians) + len(split)


def _halves(planes: Tensor, random: np.random.Generator) -> Tensor:
    """Children (P, M) of Gaussians to be split: drawn from the Gaussian itself, and smaller."""
    if not planes.shape[1]:
        return planes
    offsets = torch.from_numpy(random.normal(size=(3, planes.shape[1])).astype(np.float32)).to(planes)
    offsets = offsets * planes[LOG_SCALE].exp()
    children = planes.clone()
    children[MEAN] += torch.einsum("nij,jn->in", _rotations(planes), offsets)
    children[LOG_SCALE] -= float(np.log(_SHRINK))
    return children


def _rotations(planes: Tensor) -> Tensor:
    """(N, 3, 3) from a Gaussian's own axes to the world."""
    w, x, y, z = NamedParameters(planes).quaternions.T
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)


def screen_radius(planes: Tensor, view: PinholeView) -> Tensor:
    """(N,) three standard deviations in the image along the longest axis, in px, rounded up as in 3DGS; 0 for what is
    not in front of the camera or whose centre is more than an image off."""
    if not planes.shape[1]:
        return planes.new_zeros(0)
    T = torch.from_numpy(view.T_cam_world).to(planes)
    x, y, z = T[:3, :3] @ planes[MEAN] + T[:3, 3:]
    in_front = (z >= THRESHOLDS.near_m) & (x.abs() * view.fx < 2 * z * view.width)
    in_front &= y.abs() * view.fy < 2 * z * view.height
    z = torch.where(in_front, z, 1.0)
    zero = torch.zeros_like(z)
    J = torch.stack(
        [
            torch.stack([view.fx / z, zero, -view.fx * x / z**2], -1),
            torch.stack([zero, view.fy / z, -view.fy * y / z**2], -1),
        ],
        -2,
    )
    A = J @ T[:3, :3] @ (_rotations(planes) * planes[LOG_SCALE].T.exp()[:, None, :])
    xx, yy = (A[:, row].square().sum(-1) + THRESHOLDS.low_pass_px2 for row in (0, 1))
    xy = (A[:, 0] * A[:, 1]).sum(-1)
    largest = (xx + yy) / 2 + torch.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    return torch.where(in_front, torch.ceil(_SIGMAS * largest.sqrt()), 0.0)


def isotropy_gradient(planes: Tensor, weight: float) -> Tensor:
    """(3, N) gradient by the log scales of weight * mean |s - mean(s)|, the mean over a Gaussian's three axes."""
    scales = planes[LOG_SCALE].exp()
    signs = torch.sign(scales - scales.mean(0))
    return (signs - signs.mean(0)) * scales * (weight / max(scales.numel(), 1))
