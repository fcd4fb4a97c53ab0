"""The oracle: every pixel times every Gaussian, in float64 torch. For small scenes only."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bench.contracts.rasterizer import Observation
from bench.gaussians.autograd import AutogradRasterizer, perturbed
from bench.gaussians.schema import LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, THRESHOLDS
from bench.gaussians.spherical_harmonics import colors
from bench.registry import PluginConfig, register
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor


@register("rasterizer", "reference")
class ReferenceRasterizer(AutogradRasterizer):
    """Float64 torch rasterizer for small scenes, the oracle that the fast ones are tested against."""

    precision = "float64"

    def __init__(self, config: PluginConfig) -> None:
        self.device = torch.device("cpu")

    def splat(self, planes: Tensor, view: PinholeView, twist: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        R, t = perturbed(torch.as_tensor(view.T_cam_world, dtype=planes.dtype), twist)
        color = colors(planes, -R.T @ t)
        z, order, alpha, before, following = self._layers(planes, view, R, t)
        weight = torch.where(following > THRESHOLDS.transmittance_end, alpha * before, torch.zeros_like(alpha))
        shape = (view.height, view.width)
        visible = torch.zeros(planes.shape[1], dtype=torch.bool)
        visible[order] = (alpha > 0).any(1)
        return (
            (color[:, order] @ weight).reshape(3, *shape),
            (z[order] @ weight).reshape(shape),
            weight.sum(0).reshape(shape),
            visible,
        )

    def observe(self, planes: Tensor, view: PinholeView) -> Observation:
        T = torch.as_tensor(view.T_cam_world, dtype=self.dtype)
        z, order, alpha, before, following = self._layers(planes.to(self.dtype), view, T[:3, :3], T[:3, 3])
        pixels = torch.zeros(planes.shape[1], dtype=torch.int32)
        pixels[order] = ((alpha > 0) & (before > 0.5)).sum(1, dtype=torch.int32)
        falls = (before > 0.5) & (following <= 0.5)  # at most once per pixel
        depth = torch.where(falls.any(0), z[order] @ falls.to(z), torch.nan)
        return Observation(pixels, depth.reshape(view.height, view.width).float())

    def _layers(self, planes: Tensor, view: PinholeView, R: Tensor, t: Tensor) -> tuple[Tensor, ...]:
        """Depths (N,), nearest first ``order`` (N,); in that order alpha, transmittance before and behind, (N, H W)."""
        p_cam = planes[MEAN].T @ R.T + t
        z = p_cam[:, 2]
        near = z >= THRESHOLDS.near_m
        safe_z = torch.where(near, z, torch.ones_like(z))
        center = torch.stack([view.fx * p_cam[:, 0] / safe_z + view.cx, view.fy * p_cam[:, 1] / safe_z + view.cy], 1)
        covariance = self._image_covariance(planes, R, p_cam, safe_z, view)
        conic = torch.linalg.inv(covariance)
        opacity = torch.sigmoid(planes[OPACITY_LOGIT])
        # Depth order as a float32 renderer sees it, ties by index.
        order = torch.argsort(z.detach().float(), stable=True)
        ys, xs = torch.meshgrid(torch.arange(view.height), torch.arange(view.width), indexing="ij")
        pixels = torch.stack([xs, ys], -1).reshape(-1, 2).to(planes.dtype)
        d = pixels[None] - center[order][:, None]
        power = -0.5 * torch.einsum("npi,nij,npj->np", d, conic[order], d)
        raw = opacity[order][:, None] * torch.exp(power)
        shown = (raw >= THRESHOLDS.alpha_min) & near[order][:, None]
        alpha = torch.where(shown, raw.clamp_max(THRESHOLDS.alpha_max), torch.zeros_like(raw))
        following = torch.cumprod(1.0 - alpha, 0)
        before = torch.cat([torch.ones_like(following[:1]), following[:-1]])
        return z, order, alpha, before, following

    def _image_covariance(self, planes: Tensor, R: Tensor, p_cam: Tensor, z: Tensor, view: PinholeView) -> Tensor:
        """J W Sigma W^T J^T + 0.3 I, (N, 2, 2) px^2 (paper, Eq. 2)."""
        w, x, y, q = torch.nn.functional.normalize(planes[QUATERNION], dim=0)
        rotation = torch.stack(
            [
                torch.stack([1 - 2 * (y * y + q * q), 2 * (x * y - w * q), 2 * (x * q + w * y)], -1),
                torch.stack([2 * (x * y + w * q), 1 - 2 * (x * x + q * q), 2 * (y * q - w * x)], -1),
                torch.stack([2 * (x * q - w * y), 2 * (y * q + w * x), 1 - 2 * (x * x + y * y)], -1),
            ],
            -2,
        )
        M = rotation * planes[LOG_SCALE].T.exp()[:, None, :]
        # The Jacobian is taken at most a margin beyond the image's borders, as in gsplat.
        margin_x = THRESHOLDS.jacobian_margin * view.width / view.fx
        margin_y = THRESHOLDS.jacobian_margin * view.height / view.fy
        rx = (p_cam[:, 0] / z).clamp(
            -((view.cx + 0.5) / view.fx + margin_x),
            (view.width - view.cx - 0.5) / view.fx + margin_x,
        )
        ry = (p_cam[:, 1] / z).clamp(
            -((view.cy + 0.5) / view.fy + margin_y),
            (view.height - view.cy - 0.5) / view.fy + margin_y,
        )
        zero = torch.zeros_like(z)
        J = torch.stack(
            [
                torch.stack([view.fx / z, zero, -view.fx * rx / z], -1),
                torch.stack([zero, view.fy / z, -view.fy * ry / z], -1),
            ],
            -2,
        )
        A = J @ R @ M
        return A @ A.transpose(1, 2) + THRESHOLDS.low_pass_px2 * torch.eye(2, dtype=planes.dtype)
