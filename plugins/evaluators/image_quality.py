"""PSNR, SSIM and LPIPS of the saved renders against the data set's images."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.contracts.evaluator import Evaluator
from bench.errors import BenchError
from bench.evaluation.image import psnr, ssim
from bench.evaluation.lpips_metric import Lpips
from bench.evaluation.regions import psnr_where, ssim_where, unit_range
from bench.evaluation.run_lpips import lpips_of
from bench.evaluation.saved_run import GROUPS, VIEW_OF_GROUP, SavedRun
from bench.evaluation.ssim_flavours import ms_ssim, ssim_3dgs
from bench.protocol import Protocol
from bench.registry import PluginConfig, register
from bench.runs.folder import View
from bench.types import Image, Mask

Scores = dict[tuple[View, int], dict[str, float | None]]
"""Metrics of each image; one that can't be computed is None for all of them."""


@register("evaluator", "image")
class ImageEvaluator(Evaluator):
    """PSNR, SSIM and LPIPS of left, training, held-out and right views."""

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``views.<group>`` with n, psnr_db, ssim, lpips (means of per-image values); absent groups have no view."""
        if not (run.rendered("left") or run.rendered("right")):
            return {"views": {}, "notes": {"image": "the run saved no renders"}}
        if run.protocol.sky == "out":
            if run.dataset.true_sky(0) is None:
                return {"views": {}, "notes": {"image": _no_sky(run)}}
            reason = "LPIPS is of whole images, and protocol.sky=out leaves a part of them out"
            lpips, about_lpips = None, {"notes": {"lpips": reason}}
        else:
            lpips, about_lpips = lpips_of(run)
        scores = _score_views(run, lpips)
        for (view, number), values in scores.items():
            run.add_per_frame(view, number, **values)
        views = {}
        for group in GROUPS:
            view = VIEW_OF_GROUP[group]
            of_group = [scores[view, number] for number in run.numbers(view, group) if (view, number) in scores]
            if of_group:
                views[group] = {"n": len(of_group)} | {
                    metric: _mean([values[metric] for values in of_group]) for metric in of_group[0]
                }
        return {"views": views, **about_lpips}


def _score_views(run: SavedRun, lpips: Lpips | None) -> Scores:
    """Each render against its image, decoded once and scored once; ordered by frame."""
    left = set(run.rendered("left"))
    right = set(run.rendered("right")) if run.protocol.right_view else set()
    position_of = {number: position for position, number in enumerate(run.dataset.numbers)}
    scores: Scores = {}
    numbers = sorted(left | right)
    for done, number in enumerate(numbers):
        run.report_progress("images", done, len(numbers))
        if number not in position_of:
            raise BenchError(
                f"{run.path} holds a render of frame {number}, which its data set {run.dataset.label} does not have. "
                "Check that the data set's files are those of the run."
            )
        frame = run.dataset.frame(position_of[number])
        counts = _pixels_that_count(run, position_of[number])
        if number in left:
            scores["left", number] = _score(run, "left", number, frame.left, lpips, counts)
        if number in right:
            scores["right", number] = _score(run, "right", number, frame.right, lpips, None)
    run.report_progress("images", len(numbers), len(numbers))
    return scores


def _pixels_that_count(run: SavedRun, position: int) -> Mask | None:
    """Of a left image, by the protocol: those that are not sky, or None for all."""
    if run.protocol.sky == "in":
        return None
    sky = run.dataset.true_sky(position)
    if sky is None:
        raise BenchError(f"Frame {run.dataset.numbers[position]}: {_no_sky(run)}.")
    return ~sky


def _no_sky(run: SavedRun) -> str:
    return f"the data set {run.dataset.label} does not know where its sky is; use protocol.sky=in"


def _score(
    run: SavedRun, view: View, number: int, image: Image, lpips: Lpips | None, counts: Mask | None
) -> dict[str, float | None]:
    render = run.render(view, number)
    assert render is not None  # the caller asks for renders that are there
    if render.shape != image.shape:
        raise BenchError(
            f"The {view} render of frame {number} in {run.path} is {render.shape[1]}x{render.shape[0]} pixels, "
            f"the data set's image {image.shape[1]}x{image.shape[0]}. Are its files those of the run?"
        )
    if counts is not None:
        scores = psnr_where(render, image, counts), ssim_where(render, image, counts, run.protocol.ssim)
        # An image that is all sky has no score.
        known = [value if math.isfinite(value) else None for value in scores]
        return {"psnr_db": known[0], "ssim": known[1], "lpips": None}
    return {
        "psnr_db": psnr(render, image),
        "ssim": _ssim(render, image, run.protocol),
        "lpips": None if lpips is None else lpips([render], [image])[0],
    }


def _ssim(render: Image, image: Image, protocol: Protocol) -> float:
    if protocol.ssim == "skimage-gaussian":
        return ssim(render, image)
    flavour = ssim_3dgs if protocol.ssim == "3dgs" else ms_ssim
    return flavour(unit_range(render), unit_range(image))


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
