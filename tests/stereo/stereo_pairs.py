"""Pairs whose disparity is known by construction, a block matcher in numpy, and the KITTI 2015 sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from bench.types import Image, Map


def textured(height: int, width: int, seed: int = 0) -> Image:
    """A random grey picture with structure of about four pixels, (H, W, 3)."""
    noise = np.random.default_rng(seed).standard_normal((height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    grey = np.clip(128 + 50 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def shifted_pair(height: int, width: int, shift: int, seed: int = 0) -> tuple[Image, Image]:
    """A wall with the same disparity everywhere: what the left image has at x, the right one has at x - shift."""
    wall = textured(height, width + shift, seed)
    return np.ascontiguousarray(wall[:, :width]), np.ascontiguousarray(wall[:, shift:])


def card_before_wall(height: int, width: int, near: int, far: int) -> tuple[Image, Image, slice]:
    """A wall at disparity ``far`` behind a card at ``near`` px; and the columns of the left image that the right camera
    can't see, just left of the card."""
    left, right = shifted_pair(height, width, far, seed=1)
    start, stop = width // 2, width // 2 + width // 4
    card = textured(height, stop - start, seed=2)
    left[:, start:stop] = card
    right[:, start - near : stop - near] = card
    return left, right, slice(start - (near - far), start)


def block_match(left: Image, right: Image, disparities: int = 40, block: int = 7) -> Map:
    """Disparity with the least sum of absolute differences over a block, (H, W) float32; looks block // 2 rows far."""
    height, width = left.shape[:2]
    costs = np.full((disparities, height, width), np.inf, np.float32)
    for d in range(min(disparities, width)):
        difference = np.full((height, width), 255.0, np.float32)
        difference[:, d:] = np.abs(left[:, d:, 0].astype(np.float32) - right[:, : width - d, 0])
        costs[d] = cv2.boxFilter(difference, -1, (block, block), borderType=cv2.BORDER_REPLICATE)
    return np.argmin(costs, axis=0).astype(np.float32)


def kitti_2015_sample(test_data: Path) -> tuple[Image, Image, Map]:
    """The sample's images and its ground truth in px, NaN where there is none."""
    root = test_data / "kitti2015_sample"
    left, right = (_read(root / side / "000046_10.png", cv2.IMREAD_COLOR)[..., ::-1] for side in ("image_2", "image_3"))
    truth = _read(root / "disp_occ_0" / "000046_10.png", cv2.IMREAD_UNCHANGED).astype(np.float32) / np.float32(256)
    truth[truth == 0] = np.nan
    return np.ascontiguousarray(left), np.ascontiguousarray(right), truth


def _read(path: Path, flags: int) -> npt.NDArray[Any]:
    image = cv2.imread(str(path), flags)
    assert image is not None, path
    return image


def end_point_error(disparity: Map, truth: Map) -> float:
    """Mean absolute error over the pixels with ground truth; NaN if one of them is not filled."""
    known = np.isfinite(truth)
    return float(np.abs(disparity[known] - truth[known]).mean())
