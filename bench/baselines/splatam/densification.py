"""Where SplaTAM's map grows: pixels that it does not show yet, or shows too far away, become Gaussians."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bench.contracts.rasterizer import Rendered
from bench.gaussians.parameters import planes_from
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor

_ERROR_FACTOR = 50
_OPACITY = 0.5


def to_add(rendered: Rendered, depth: Tensor, silhouette: float) -> Tensor:
    """Pixels (H, W) bool of known ``depth`` (H, W) metres, 0 where unknown, that need a Gaussian.

    Either the render's alpha is below ``silhouette``, or its depth lies behind the known one and is wrong by more than
    50 times the median error. Pixels of unknown depth count with an error of 0 in that median: with less than half of
    the depth known (LiDAR) it is 0, and all that lies behind is replaced.
    """
    known = depth > 0
    error = torch.where(known, (rendered.depth - depth).abs(), 0.0)
    behind = (rendered.depth > depth) & (error > _ERROR_FACTOR * error.median())
    return known & ((rendered.alpha < silhouette) | behind)


def gaussians_of(which: Tensor, image: Tensor, depth: Tensor, view: PinholeView) -> Tensor:
    """New Gaussians (14, M), one for each pixel of ``which`` (H, W): of one pixel's size, half opaque.

    ``image`` (3, H, W) RGB in [0, 1], ``depth`` (H, W) metres.
    """
    v, u = torch.nonzero(which, as_tuple=True)
    z = depth[v, u].double()
    in_camera = torch.stack([(u - view.cx) / view.fx * z, (v - view.cy) / view.fy * z, z])
    T_world_cam = torch.from_numpy(view.T_world_cam).to(z.device)
    # Products one by one: those of torch's matrices may differ in the last bits with the number of threads.
    rotated = (T_world_cam[:3, :3, None] * in_camera[None]).sum(1)
    means = (rotated + T_world_cam[:3, 3:]).float().T
    scales = (z / ((view.fx + view.fy) / 2)).float()[:, None].expand(-1, 3)
    quaternions = means.new_tensor([1.0, 0.0, 0.0, 0.0]).expand(len(z), -1)
    return planes_from(means, scales, quaternions, torch.full_like(means[:, 0], _OPACITY), image[:, v, u].T)
