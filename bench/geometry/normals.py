"""Surface normals of a depth map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor

FORMS = ("points", "slopes")
"""What :func:`normals_from_depth` can make normals of."""


def normals_from_depth(
    depth: Tensor, known: Tensor, view: PinholeView, form: str = "points", step: int = 1
) -> tuple[Tensor, Tensor]:
    """Unit normals (3, H, W) in the camera's frame, and where they are valid (H, W) bool.

    Of each pixel and its neighbours ``step`` pixels to the right and below. ``form`` "points": the cross product of the
    differences of the back-projected pixels, facing the camera; "slopes": (-dz/du, -dz/dv, 1) of the depth image
    itself, z in metres and u, v in pixels, which is no direction in space. Valid where the pixel and both neighbours
    have a known depth (H, W). Differentiable by ``depth``. (Paper, Sec. "Mapping"; METHOD: normals.)
    """
    h, w = depth.shape
    valid = torch.zeros_like(known)
    if step >= min(h, w):
        return depth.new_zeros((3, h, w)) + 0.0 * depth, valid
    here, right, below = (
        (slice(None, -step), slice(None, -step)),
        (slice(None, -step), slice(step, None)),
        (slice(step, None), slice(None, -step)),
    )
    if form == "slopes":
        du, dv = (depth[right] - depth[here]) / step, (depth[below] - depth[here]) / step
        normal = torch.stack([-du, -dv, torch.ones_like(du)])
    else:
        x = (torch.arange(w, device=depth.device, dtype=depth.dtype) - view.cx) / view.fx
        y = (torch.arange(h, device=depth.device, dtype=depth.dtype) - view.cy) / view.fy
        points = torch.stack([x[None, :] * depth, y[:, None] * depth, depth])
        across, down = points[:, *right] - points[:, *here], points[:, *below] - points[:, *here]
        normal = torch.linalg.cross(down, across, dim=0)
    valid[here] = known[here] & known[right] & known[below]
    # The length is about depth^2 / f^2: far above the epsilon for real surfaces, and safe where depth is zero.
    unit = normal / torch.sqrt((normal * normal).sum(0) + 1e-20)
    return torch.nn.functional.pad(unit, (0, step, 0, step)), valid
