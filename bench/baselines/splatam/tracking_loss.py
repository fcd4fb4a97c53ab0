"""SplaTAM's tracking loss: sums of depth and colour errors over the pixels that the map is sure of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from bench.types import Image, Map

if TYPE_CHECKING:
    from torch import Tensor


class TrackingLoss:
    """depth_weight sum |D - D*| + color_weight sum |I - I*| over the pixels (and channels) whose depth D* is known and
    whose alpha is above ``silhouette``.

    An image loss for ``MapView.differentiate``, with its gradients in closed form. The mask has no gradient. After a
    call ``pixels`` is the number of pixels that counted, ``depth_loss`` the weighted part of the depth.
    """

    pixels = 0
    depth_loss = 0.0

    def __init__(self, image: Image, depth: Map, silhouette: float, depth_weight: float, color_weight: float) -> None:
        """``image`` (H, W, 3) RGB, ``depth`` (H, W) metres, NaN where unknown."""
        self._silhouette, self._depth_weight, self._color_weight = silhouette, depth_weight, color_weight
        known = np.isfinite(depth)
        self._known = torch.from_numpy(known)
        self._depth = torch.from_numpy(np.where(known, depth, 0.0).astype(np.float32))
        self._image = torch.from_numpy(image).permute(2, 0, 1).float().div_(255.0).contiguous()

    def __call__(self, color: Tensor, depth: Tensor, alpha: Tensor) -> Tensor:
        """The loss of a render, float64; its gradients are in the dtype of the images."""
        from bench.supervision.known_gradients import KnownGradients  # here: it imports torch

        with torch.no_grad():
            value, by_color, by_depth = self.evaluate(color, depth, alpha)
        derived: Tensor = KnownGradients.apply(
            color, depth, torch.tensor(value, dtype=torch.float64), by_color, by_depth
        )
        return derived

    def evaluate(self, color: Tensor, depth: Tensor, alpha: Tensor) -> tuple[float, Tensor, Tensor]:
        """The value, and its gradients by colour (3, H, W) and depth (H, W)."""
        for name in ("_known", "_depth", "_image"):
            setattr(self, name, getattr(self, name).to(color.device))
        mask = self._known & (alpha > self._silhouette)
        of_depth, of_color = depth - self._depth, color - self._image
        errors = torch.stack([of_depth.abs() * self._depth_weight, of_color.abs().sum(0) * self._color_weight])
        # Summed by numpy in one fixed order: torch's order depends on the number of threads.
        sums = (errors * mask).cpu().numpy().sum(axis=(1, 2), dtype=np.float64)
        self.pixels, self.depth_loss = int(mask.sum()), float(sums[0])
        by_color, by_depth = of_color.sign_().mul_(mask * self._color_weight), of_depth.sign_().mul_(mask)
        return float(sums.sum()), by_color, by_depth.mul_(self._depth_weight)
