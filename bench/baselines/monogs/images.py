"""What MonoGS compares: weighted absolute differences of colour and depth with their gradients, and its edge mask."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch

from bench.types import Image, Map, Mask

if TYPE_CHECKING:
    from torch import Tensor

BLACK = 0.01
"""Pixels whose red, green and blue (0 to 1) add up to no more than this count as black: they say nothing."""
_LEAST_DEPTH_M = 0.01
_OPAQUE = 0.95
_BLOCKS = 32

Exposure = tuple[float, float]
"""(a, b): an image is exp(a) times the map's colours plus b."""


@dataclass(frozen=True)
class Compared:
    """Weighted sums of absolute differences of colour and depth, and their gradients by the rendered ``color``
    (3, H, W), ``depth`` (H, W) and the exposure (a, b)."""

    color_value: float
    depth_value: float
    by_color: Tensor
    by_depth: Tensor
    by_exposure: tuple[float, float]


def compare(
    color: Tensor,
    depth: Tensor,
    image: Tensor,
    true_depth: Tensor,
    weights: tuple[Tensor, Tensor],
    exposure: Exposure,
) -> Compared:
    """Sum of w_c |exp(a) color + b - image| over (3, H, W), and of w_d |depth - true_depth| over (H, W).

    ``weights``: w_c and w_d, (H, W) each. Derivatives in closed form: a render is compared a hundred times a frame.
    """
    a, b = exposure
    gain = math.exp(a)
    error = color.mul(gain).add_(b).sub_(image)
    by_shown = torch.sign(error).mul_(weights[0])
    color_value = _sum(error, by_shown)
    by_b = _sum(by_shown)
    # exp(a) color = error + image - b
    by_a = color_value + _sum(by_shown, image) - b * by_b
    off = depth - true_depth
    by_depth = torch.sign(off).mul_(weights[1])
    return Compared(color_value, _sum(off, by_depth), by_shown.mul_(gain), by_depth, (by_a, by_b))


def _sum(one: Tensor, other: Tensor | None = None) -> float:
    """Sum of an image, or of the product of two; in an order that the number of threads does not change."""
    rows = one.sum(-1) if other is None else torch.linalg.vecdot(one, other)
    return float(rows.double().cpu().numpy().sum())


class TrackingLoss:
    """The loss of MonoGS's tracking, for ``MapView.differentiate``; ``exposure`` may be set between two calls.

    share * mean(S m |I' - I*|) + (1 - share) * mean(d |D - D*|), means over all values; I' is the render with the
    exposure, S its opacity (a weight: no gradient by it), m the pixels of ``mask`` (H, W), d those whose depth is known
    and whose opacity is above 0.95. ``by_exposure``: the gradient by (a, b) of the call before.
    """

    def __init__(self, image: Image, depth: Map, mask: Mask, share: float) -> None:
        self._image = torch.from_numpy(image).permute(2, 0, 1).float().div_(255.0).contiguous()
        self._depth = torch.from_numpy(np.nan_to_num(depth))
        pixels = mask.size
        self._color_weight = torch.from_numpy(mask.astype(np.float32) * np.float32(share / (3 * pixels)))
        self._depth_weight = (self._depth > _LEAST_DEPTH_M).float().mul_((1 - share) / pixels)
        self.exposure: Exposure = (0.0, 0.0)
        self.by_exposure = (0.0, 0.0)

    def __call__(self, color: Tensor, depth: Tensor, alpha: Tensor) -> Tensor:
        """A scalar that autograd can derive by ``color`` (3, H, W) and ``depth`` (H, W)."""
        if self._image.device != color.device:
            for name in ("_image", "_depth", "_color_weight", "_depth_weight"):
                setattr(self, name, getattr(self, name).to(color.device))
        seen = alpha.detach()
        weights = self._color_weight * seen, self._depth_weight * (seen > _OPAQUE)
        with torch.no_grad():
            compared = compare(color, depth, self._image, self._depth, weights, self.exposure)
        self.by_exposure = compared.by_exposure
        value = torch.tensor(compared.color_value + compared.depth_value, dtype=color.dtype, device=color.device)
        from bench.supervision.known_gradients import KnownGradients  # here: it imports torch

        derived: Tensor = KnownGradients.apply(color, depth, value, compared.by_color, compared.by_depth)
        return derived


def not_black(image: Image) -> Mask:
    """(H, W): pixels that are not black."""
    bright: Mask = image.sum(2, dtype=np.int32) > BLACK * 255
    return bright


def edge_mask(image: Image, threshold: float, blocks: bool) -> Mask:
    """(H, W): pixels whose grey value changes more than ``threshold`` times the median change.

    The change is the length of the Scharr gradient (kernels 3-10-3, divided by 32) of the mean of the channels, 0 where
    a pixel or a neighbour is black. With ``blocks`` the medians are those of 32 x 32 blocks over the image.
    """
    grey = image.mean(2, dtype=np.float32) / np.float32(255.0)
    dx, dy = (
        cv2.Scharr(grey, cv2.CV_32F, 1 - axis, axis, scale=1 / 32, borderType=cv2.BORDER_REFLECT_101) for axis in (0, 1)
    )
    lit = cv2.erode((grey > BLACK).astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REFLECT_101)
    change = np.sqrt(dx * dx + dy * dy) * lit
    if not blocks:
        return np.asarray(change > threshold * np.median(change))
    mask = np.zeros(change.shape, bool)
    rows, columns = (np.linspace(0, side, min(_BLOCKS, side) + 1).astype(int) for side in change.shape)
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            block = change[top:bottom, left:right]
            mask[top:bottom, left:right] = block > threshold * np.median(block)
    return mask
