"""What a keyframe's render is compared with: the image, the stereo depth, and what the loss terms derive from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch

from bench.geometry.normals import normals_from_depth
from bench.supervision.ssim import local_statistics
from bench.types import Keyframe, Mask, PinholeView

if TYPE_CHECKING:
    from torch import Tensor

SATURATED = 250 / 255
"""From here on a channel of a pixel is saturated."""


@dataclass(frozen=True, eq=False)
class Target:
    """Supervision of one view at one resolution, as tensors on the rasterizer's device.

    ``image`` (3, H, W) RGB in [0, 1]; ``depth`` (H, W) metres, 0 where it does not supervise; ``depth_mask`` (H, W)
    bool, the paper's M: stereo depth known, within the depth range, not sky; ``confidence`` (H, W) in the depth, from 0
    to 1, or None from a stereo plugin that has none; ``color_mask`` (H, W) bool, what the terms on colour
    see, or None for all.
    """

    image: Tensor
    depth: Tensor
    depth_mask: Tensor
    view: PinholeView
    confidence: Tensor | None = None
    color_mask: Tensor | None = None

    @cached_property
    def limit(self) -> Tensor:
        """(3, H, W) The image where it is saturated, which says only that there was at least so much light, else
        infinity."""
        return torch.where(self.image >= SATURATED, self.image, torch.inf)

    @cached_property
    def edge_weight(self) -> Tensor:
        """g = exp(-|grad I|), (H, W), I grey in [0, 1] (paper, below Eq. 15); central differences."""
        grey = self.image.mean(0)
        dx, dy = torch.zeros_like(grey), torch.zeros_like(grey)
        dx[:, 1:-1] = (grey[:, 2:] - grey[:, :-2]) / 2
        dy[1:-1] = (grey[2:] - grey[:-2]) / 2
        return torch.exp(-torch.sqrt(dx * dx + dy * dy))

    @cached_property
    def confident_edge_weight(self) -> Tensor:
        """``edge_weight`` times ``confidence``, (H, W)."""
        assert self.confidence is not None
        return self.edge_weight * self.confidence

    def normals(self, form: str, step: int) -> tuple[Tensor, Tensor]:
        """Unit normals (3, H, W) of the stereo depth and where they are valid (H, W): see ``normals_from_depth``."""
        if (form, step) not in self._normals:
            self._normals[form, step] = normals_from_depth(self.depth, self.depth_mask, self.view, form, step)
        return self._normals[form, step]

    @cached_property
    def _normals(self) -> dict[tuple[str, int], tuple[Tensor, Tensor]]:
        return {}

    @cached_property
    def local_statistics(self) -> tuple[Tensor, Tensor]:
        """Gaussian-weighted local mean and variance of the image, (3, H, W) each, for SSIM."""
        return local_statistics(self.image)

    def halved(self) -> Target:
        """The same target at half the resolution: image averaged, depth picked (never averaged over an edge)."""
        view = self.view.halved()
        h, w = view.height, view.width
        image = torch.nn.functional.avg_pool2d(self.image[None], 2)[0].contiguous()
        pick = (slice(0, 2 * h, 2), slice(0, 2 * w, 2))
        confidence, color_mask = (
            None if each is None else each[pick].contiguous() for each in (self.confidence, self.color_mask)
        )
        depth, depth_mask = self.depth[pick].contiguous(), self.depth_mask[pick].contiguous()
        return Target(image, depth, depth_mask, view, confidence, color_mask)


COLOR_PIXELS = ("all", "ground", "supervised")
"""What the terms on colour can see: every pixel, all but the sky, or only the paper's M."""


def depth_in_range(keyframe: Keyframe, depth_range_m: tuple[float, float]) -> Mask:
    """Where the stereo depth is known, lies within [near, far] metres and is not of the sky, (H, W)."""
    depth = keyframe.depth.depth
    with np.errstate(invalid="ignore"):
        mask = np.isfinite(depth) & (depth >= depth_range_m[0]) & (depth <= depth_range_m[1])
    return mask if keyframe.sky is None else mask & ~keyframe.sky


def target_of(
    keyframe: Keyframe,
    view: PinholeView,
    depth_range_m: tuple[float, float],
    device: torch.device,
    color_pixels: str = "all",
    ignored: Mask | None = None,
) -> Target:
    """The full-resolution target of a keyframe; ``depth_range_m`` limits which stereo depth supervises, and
    ``color_pixels`` is one of ``COLOR_PIXELS``. What is ``ignored`` (H, W) neither has a depth nor a colour."""
    image = torch.from_numpy(keyframe.frame.left).to(device).permute(2, 0, 1).float().div_(255.0).contiguous()
    depth, mask = keyframe.depth.depth, depth_in_range(keyframe, depth_range_m)
    ground = np.ones(depth.shape, bool) if keyframe.sky is None else ~keyframe.sky
    color_mask = {"all": None, "ground": ground, "supervised": mask}[color_pixels]
    if ignored is not None:
        mask = mask & ~ignored
        color_mask = ~ignored if color_mask is None else color_mask & ~ignored
    return Target(
        image,
        torch.from_numpy(np.where(mask, depth, 0.0).astype(np.float32)).to(device),
        torch.from_numpy(mask).to(device),
        view,
        None if keyframe.depth.confidence is None else torch.from_numpy(keyframe.depth.confidence).to(device),
        None if color_mask is None else torch.from_numpy(color_mask).to(device),
    )


def right_target_of(
    keyframe: Keyframe, view: PinholeView, depth_range_m: tuple[float, float], device: torch.device
) -> Target:
    """The full-resolution target of a keyframe's right image, without depth: stereo knows that of the left image."""
    _, right = keyframe.frame.pair("Learning from right images", "mapper.right_images=0")
    blind = replace(keyframe.depth, depth=np.full(right.shape[:2], np.nan, np.float32))
    return target_of(
        replace(keyframe, frame=replace(keyframe.frame, left=right), depth=blind, sky=None), view, depth_range_m, device
    )
