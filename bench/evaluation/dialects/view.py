"""One view under several dialects; what they share is computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bench.contracts.saved_run import SavedView
from bench.evaluation.dialects.dialect import Dialect
from bench.evaluation.regions import unit_range
from bench.types import Image

METRICS = ("psnr_db", "ssim", "lpips", "depth_l1_cm")

Scores = dict[str, float | None]
Distance = Callable[[Sequence[Image], Sequence[Image]], list[float]]


def score_view(
    dialects: Sequence[Dialect], view: SavedView, render: Image, lpips: Distance | None
) -> dict[str, Scores]:
    """``METRICS`` by name of the dialect; None where one can't be had, NaN or infinite where its formula is.

    ``render`` is the view's, uint8 (H, W, 3); ``lpips`` serves masked images, whole ones have ``view.lpips``.
    """
    image, depth, reference = view.image, view.depth, view.sensor_depth if view.lidar is None else view.lidar
    known = None if reference is None else reference > 0
    colors = unit_range(render), unit_range(image)
    masked_lpips: float | None = None
    scores: dict[str, Scores] = {}
    for dialect in dialects:
        if dialect.needs_depth and known is None:
            scores[dialect.name] = dict.fromkeys(METRICS)
            continue
        if dialect.lpips_is_masked and masked_lpips is None and lpips is not None and known is not None:
            masked_lpips = lpips(*([picture * known[..., None].astype(np.uint8)] for picture in (render, image)))[0]
        depth_l1 = None
        if dialect.depth_l1_m is not None and depth is not None and reference is not None:
            depth_l1 = 100.0 * dialect.depth_l1_m(depth, reference)
        scores[dialect.name] = {
            "psnr_db": dialect.psnr_db(*colors, known),
            "ssim": dialect.ssim(*colors, known) if min(image.shape[:2]) >= dialect.ssim_minimum_side else None,
            "lpips": masked_lpips if dialect.lpips_is_masked else view.lpips,
            "depth_l1_cm": depth_l1,
        }
    return scores
