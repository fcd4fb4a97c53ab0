"""One view under several dialects; what they share is computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bench.evaluation.dialects.dialect import Dialect
from bench.evaluation.regions import unit_range
from bench.types import Image, Map, Mask

METRICS = ("psnr_db", "ssim", "lpips", "depth_l1_cm")

Scores = dict[str, float | None]
Distance = Callable[[Sequence[Image], Sequence[Image]], list[float]]


def score_view(
    dialects: Sequence[Dialect],
    render: Image,
    image: Image,
    depth: Map | None,
    reference: Map | None,
    lpips: Distance | None,
    whole_lpips: float | None = None,
) -> dict[str, Scores]:
    """``METRICS`` by name of the dialect; None where one can't be had, NaN or infinite where its formula is.

    ``render`` and ``image`` are uint8 (H, W, 3) of the same size, ``depth`` and ``reference`` float32 (H, W) metres.
    ``whole_lpips`` is the LPIPS of the whole images where it is known already.
    """
    known = None if reference is None else reference > 0
    colors = unit_range(render), unit_range(image)
    distances: dict[bool, float | None] = {} if whole_lpips is None else {False: whole_lpips}
    scores: dict[str, Scores] = {}
    for dialect in dialects:
        if dialect.needs_depth and known is None:
            scores[dialect.name] = dict.fromkeys(METRICS)
            continue
        is_masked = dialect.lpips_is_masked
        if is_masked not in distances:
            distances[is_masked] = _distance(lpips, render, image, known if is_masked else None)
        depth_l1 = None
        if dialect.depth_l1_m is not None and depth is not None and reference is not None:
            depth_l1 = 100.0 * dialect.depth_l1_m(depth, reference)
        scores[dialect.name] = {
            "psnr_db": dialect.psnr_db(*colors, known),
            "ssim": dialect.ssim(*colors, known) if min(image.shape[:2]) >= dialect.ssim_minimum_side else None,
            "lpips": distances[is_masked],
            "depth_l1_cm": depth_l1,
        }
    return scores


def _distance(lpips: Distance | None, render: Image, image: Image, known: Mask | None) -> float | None:
    if lpips is None:
        return None
    if known is not None:
        render, image = (picture * known[..., None].astype(np.uint8) for picture in (render, image))
    return lpips([render], [image])[0]
