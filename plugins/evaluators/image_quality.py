"""PSNR, SSIM and LPIPS of the saved renders against the data set's images."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.contracts.evaluator import ViewEvaluator, ViewScores
from bench.contracts.metric import Metric
from bench.contracts.saved_run import GROUPS, VIEW_OF_GROUP, SavedRun, SavedView
from bench.errors import BenchError
from bench.evaluation.image import psnr, ssim
from bench.evaluation.regions import psnr_where, ssim_where, unit_range
from bench.evaluation.ssim_flavours import ms_ssim, ssim_3dgs
from bench.protocol import Protocol
from bench.registry import PluginConfig, register
from bench.types import Image


@register("evaluator", "image")
class ImageEvaluator(ViewEvaluator):
    """PSNR, SSIM and LPIPS of left, training, held-out and right views."""

    metrics = (
        Metric("psnr_db", "PSNR", "dB", "higher", 2, "views.left.psnr_db", "always", order=40),
        Metric("ssim", "SSIM", "", "higher", 3, "views.left.ssim", "always", order=41),
        Metric("lpips", "LPIPS", "", "lower", 3, "views.left.lpips", "always", order=42),
        Metric("heldout_psnr_db", "Held-out PSNR", "dB", "higher", 2, "views.heldout.psnr_db", "always", order=50),
        Metric("right_psnr_db", "Right PSNR", "dB", "higher", 2, "views.right.psnr_db", "always", order=60),
    )

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def start(self, run: SavedRun) -> None:
        """See whether there is something to score, and with which metrics."""
        self._run = run
        self._about: dict[str, Any] = {}
        self._nothing = ""
        if not (run.rendered("left") or run.rendered("right")):
            self._nothing = "the run saved no renders"
        elif run.protocol.sky == "in":
            self._about = dict(run.lpips.about)
        elif run.dataset.true_sky(0) is None:
            self._nothing = _no_sky(run)
        else:
            reason = "LPIPS is of whole images, and protocol.sky=out leaves a part of them out"
            self._about = {"notes": {"lpips": reason}}
        if run.protocol.right_view and (reason := _about_right(run)):
            self._about = {**self._about, "notes": {**self._about.get("notes", {}), "right": reason}}

    def view(self, view: SavedView) -> dict[str, Any] | None:
        """Scores of a render against its image."""
        if self._nothing or view.render is None:
            return None
        score = _score if self._run.protocol.sky == "in" else _score_without_sky
        return score(self._run, view, view.render)

    def finish(self, scores: ViewScores) -> dict[str, Any]:
        """``views.<group>`` with n, psnr_db, ssim, lpips (means of per-image values); absent groups have no view."""
        if self._nothing:
            return {"views": {}, "notes": {"image": self._nothing}}
        for view, values in scores.items():
            self._run.add_per_frame(*view, **values)
        views = {}
        for group in GROUPS:
            camera = VIEW_OF_GROUP[group]
            of_group = [scores[camera, each] for each in self._run.numbers(camera, group) if (camera, each) in scores]
            if of_group:
                views[group] = {"n": len(of_group)} | {
                    metric: _mean([values[metric] for values in of_group]) for metric in of_group[0]
                }
        return {"views": views, **self._about}


def _score(run: SavedRun, view: SavedView, render: Image) -> dict[str, float | None]:
    image = view.image
    return {"psnr_db": psnr(render, image), "ssim": _ssim(render, image, run.protocol), "lpips": view.lpips}


def _score_without_sky(run: SavedRun, view: SavedView, render: Image) -> dict[str, float | None]:
    """Of the pixels that are not sky; an image that is all sky has no score."""
    sky = view.true_sky
    if sky is None:
        raise BenchError(f"Frame {view.number}: {_no_sky(run)}.")
    scores = psnr_where(render, view.image, ~sky), ssim_where(render, view.image, ~sky, run.protocol.ssim)
    known = [value if math.isfinite(value) else None for value in scores]
    return {"psnr_db": known[0], "ssim": known[1], "lpips": None}


def _about_right(run: SavedRun) -> str:
    """Why not all right views are scored; empty where they are."""
    if not run.dataset.has_right:
        return f"{run.dataset.label} has no right images"
    if not run.right_images_mapped:
        return ""
    which = "at held-out frames only" if run.numbers("right", "right") else "not at all, since none is held out"
    return f"mapping saw right images of keyframes, so the right camera is scored {which}"


def _no_sky(run: SavedRun) -> str:
    return f"the data set {run.dataset.label} does not know where its sky is; use protocol.sky=in"


def _ssim(render: Image, image: Image, protocol: Protocol) -> float:
    if protocol.ssim == "skimage-gaussian":
        return ssim(render, image)
    flavour = ssim_3dgs if protocol.ssim == "3dgs" else ms_ssim
    return flavour(unit_range(render), unit_range(image))


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
