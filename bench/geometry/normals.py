"""Surface normals of a depth map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor


def normals_from_depth(depth: Tensor, known: Tensor, view: PinholeView) -> tuple[Tensor, Tensor]:
    """Unit normals (3, H, W) in the camera's frame, facing the camera, and where they are valid (H, W) bool.

    Cross product of the differences of back-projected right and lower neighbours; valid where the pixel and both
    neighbours have a known depth (H, W). Differentiable by ``depth``. (Paper, Sec. "Mapping"; METHOD: normals.)
    """
    h, w = depth.shape
    x = (torch.arange(w, device=depth.device, dtype=depth.dtype) - view.cx) / view.fx
    y = (torch.arange(h, device=depth.device, dtype=depth.dtype) - view.cy) / view.fy
    points = torch.stack([x[None, :] * depth, y[:, None] * depth, depth])
    across = points[:, :-1, 1:] - points[:, :-1, :-1]
    down = points[:, 1:, :-1] - points[:, :-1, :-1]
    normal = torch.linalg.cross(down, across, dim=0)
    valid = torch.zeros_like(known)
    valid[:-1, :-1] = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1]
    # The length is about depth^2 / f^2: far above the epsilon for real surfaces, and safe where depth is zero.
    unit = normal / torch.sqrt((normal * normal).sum(0) + 1e-20)
    return torch.nn.functional.pad(unit, (0, 1, 0, 1)), valid
