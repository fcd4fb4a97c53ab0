"""PSNR, SSIM and LPIPS of the saved renders against the data set's images."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.contracts.evaluator import Evaluator
from bench.errors import BenchError
from bench.evaluation.image import psnr, ssim
from bench.evaluation.lpips_metric import MINIMUM_SIDE, Lpips, find_alexnet_weights
from bench.registry import PluginConfig, register
from bench.runs.folder import View
from bench.runs.provenance import sha256_of
from bench.runs.saved import GROUPS, VIEW_OF_GROUP, SavedRun
from bench.types import Image

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
        lpips, about_lpips = _lpips_of(run)
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


def _lpips_of(run: SavedRun) -> tuple[Lpips | None, dict[str, Any]]:
    """The metric, or None, with what ``metrics.json`` should say about it."""
    if not run.protocol.lpips:
        return None, {"notes": {"lpips": "switched off by protocol.lpips=false"}}
    camera = run.dataset.camera
    if min(camera.width, camera.height) < MINIMUM_SIDE:
        return None, {"notes": {"lpips": f"images of {camera.width}x{camera.height} pixels are too small for AlexNet"}}
    found = find_alexnet_weights(run.protocol.lpips_weights)
    if isinstance(found, str):
        return None, {"notes": {"lpips": found}}
    run.weights["lpips"] = found.path
    return Lpips(found), {"protocol": {"lpips_weights_sha256": sha256_of(found.path)}}


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
        if number in left:
            scores["left", number] = _score(run, "left", number, frame.left, lpips)
        if number in right:
            scores["right", number] = _score(run, "right", number, frame.right, lpips)
    run.report_progress("images", len(numbers), len(numbers))
    return scores


def _score(run: SavedRun, view: View, number: int, image: Image, lpips: Lpips | None) -> dict[str, float | None]:
    render = run.render(view, number)
    assert render is not None  # the caller asks for renders that are there
    if render.shape != image.shape:
        raise BenchError(
            f"The {view} render of frame {number} in {run.path} is {render.shape[1]}x{render.shape[0]} pixels, "
            f"the data set's image {image.shape[1]}x{image.shape[0]}. Are its files those of the run?"
        )
    return {
        "psnr_db": psnr(render, image),
        "ssim": ssim(render, image),
        "lpips": None if lpips is None else lpips([render], [image])[0],
    }


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
