"""Parts of an image by distance or by sky, and PSNR and SSIM of such a part alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from bench.errors import BenchError
from bench.evaluation.image import PSNR_CAP_DB
from bench.evaluation.ssim_flavours import RADIUS, Color, padded_ssim_map, ssim_map
from bench.types import Image, Map, Mask


def distance_bins(depth: Map, edges_m: Sequence[float]) -> dict[str, Mask]:
    """Masks (H, W) of the pixels with ``low <= depth < high`` metres, by name ("0-10m"); NaN is in none of them."""
    return {f"{low:g}-{high:g}m": (depth >= low) & (depth < high) for low, high in pairwise(edges_m)}


def psnr_where(image: Image, reference: Image, where: Mask) -> float:
    """PSNR in dB of two uint8 images (H, W, 3) over the pixels of a mask (H, W) alone, joint over channels.

    Pixels outside don't enter at all (painting both images black there, as some evaluators do, would lift the number
    by 10 log10 of one over the mask's share). Capped at 100 dB; NaN when no pixel counts.
    """
    _check(image, reference, where)
    difference = image[where].astype(np.int32) - reference[where]
    if not difference.size:
        return float("nan")
    squared = float(np.mean(difference * difference, dtype=np.float64))
    return PSNR_CAP_DB if squared == 0.0 else min(PSNR_CAP_DB, float(10.0 * np.log10(255.0**2 / squared)))


def ssim_where(image: Image, reference: Image, where: Mask, flavour: str) -> float:
    """Mean over the pixels of a mask (H, W) of the SSIM map of two uint8 images; NaN when no pixel counts.

    ``flavour`` is "skimage-gaussian" (a border of 5 pixels is not scored) or "3dgs" (zero padding).
    """
    _check(image, reference, where)
    colors = unit_range(image), unit_range(reference)
    if flavour == "3dgs":
        values = padded_ssim_map(*colors)[where]
    else:
        values = ssim_map(*colors)[where[RADIUS:-RADIUS, RADIUS:-RADIUS]]
    return float(np.mean(values, dtype=np.float64)) if values.size else float("nan")


def unit_range(image: Image) -> Color:
    """From uint8 to float32 in [0, 1]."""
    return image.astype(np.float32) / np.float32(255)


def _check(image: Image, reference: Image, where: Mask) -> None:
    if image.shape != reference.shape or where.shape != image.shape[:2]:
        raise BenchError(
            f"An image of {image.shape[1]}x{image.shape[0]}, a reference of {reference.shape[1]}x{reference.shape[0]} "
            f"and a mask of {where.shape[1]}x{where.shape[0]} pixels can't be compared. Check that the run fits the "
            "data set."
        )
