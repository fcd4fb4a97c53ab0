"""The saved views and trajectory as the evaluation code of other systems scores them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.contracts.evaluator import Evaluator
from bench.errors import BenchError, require_choice
from bench.evaluation.dialects.catalogue import DIALECTS
from bench.evaluation.dialects.dialect import Dialect
from bench.evaluation.dialects.view import METRICS, Scores, score_view
from bench.evaluation.lpips_metric import Lpips
from bench.evaluation.run_lpips import lpips_of
from bench.evaluation.run_trajectory import estimate_and_truth
from bench.evaluation.saved_run import SavedRun
from bench.registry import PluginConfig, register

VIEWS = ("own", "all")


@dataclass(frozen=True)
class DialectsConfig(PluginConfig):
    """Which views are scored."""

    views: str = "own"
    """own = the left views that each dialect chooses, all = every left view under each of them."""

    def __post_init__(self) -> None:
        require_choice("evaluator.dialects.views", self.views, VIEWS)


@register("evaluator", "dialects", config=DialectsConfig)
class DialectsEvaluator(Evaluator):
    """PSNR, SSIM, LPIPS, Depth-L1 and ATE by the rules of SplaTAM, MonoGS and LoopSplat."""

    def __init__(self, config: DialectsConfig) -> None:
        self.config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``dialects.<name>`` with n_views, the means of ``METRICS`` over them, ate_m, and a stamp that says how.

        The images are the saved 8-bit ones, LiDAR is the reference depth, and the rendered depth is the one that the
        run saved. What can't be computed is None, with the reason in ``notes.dialects``.
        """
        views = _views_of_each(run, self.config.views)
        lpips, about_lpips = lpips_of(run) if any(views.values()) else (None, {})
        scores = _score_views(run, views, lpips)
        weights = about_lpips.get("protocol", {})
        parts, notes = {}, []
        for dialect in DIALECTS:
            of_dialect = scores[dialect.name]
            ate = _ate(run, dialect)
            metrics = {name: _mean([score[name] for score in of_dialect]) for name in METRICS}
            metrics["ate_m"] = None if isinstance(ate, str) else ate
            parts[dialect.name] = {"n_views": len(of_dialect), **metrics, "stamp": self._stamp(run, dialect) | weights}
            reasons = [*_gaps(dialect, of_dialect), *([ate] if isinstance(ate, str) else [])]
            notes += [f"{dialect.name}: {reason}" for reason in reasons]
        about = {"dialects": "; ".join(notes)} if notes else {}
        return {"dialects": parts, "notes": about_lpips.get("notes", {}) | about}

    def _stamp(self, run: SavedRun, dialect: Dialect) -> dict[str, str]:
        stamp = dict(dialect.stamp) | {"average": "mean of per-view values", "images": "8-bit left renders"}
        stamp |= {"reference_depth": "LiDAR", "rendered_depth": run.protocol.rendered_depth}
        return stamp if self.config.views == "own" else stamp | {"views": "all left views"}


def _views_of_each(run: SavedRun, which: str) -> dict[str, list[int]]:
    """Numbers of the rendered left views that each dialect scores."""
    rendered = run.rendered("left")
    if not rendered:
        return {dialect.name: [] for dialect in DIALECTS}
    position_of = {number: position for position, number in enumerate(run.dataset.numbers)}
    if unknown := set(rendered) - position_of.keys():
        raise BenchError(
            f"{run.path} holds a render of frame {min(unknown)}, which its data set {run.dataset.label} does not have. "
            "Check that the data set's files are those of the run."
        )
    if which == "all":
        return {dialect.name: rendered for dialect in DIALECTS}
    positions = np.array([position_of[number] for number in rendered])
    mapped = np.isin(rendered, run.numbers("left", "train"))
    frames = len(run.dataset)
    return {d.name: np.array(rendered)[d.scores_view(positions, mapped, frames)].tolist() for d in DIALECTS}


def _score_views(run: SavedRun, views: dict[str, list[int]], lpips: Lpips | None) -> dict[str, list[Scores]]:
    """Scores of each dialect's views; every view is read once for all of them."""
    position_of = {number: position for position, number in enumerate(run.dataset.numbers)}
    scores: dict[str, list[Scores]] = {dialect.name: [] for dialect in DIALECTS}
    numbers = sorted(set().union(*views.values()))
    known_lpips = _known_lpips(run)
    for done, number in enumerate(numbers):
        run.report_progress("dialects", done, len(numbers))
        position = position_of[number]
        image, render = run.dataset.frame(position).left, run.render("left", number)
        assert render is not None  # only views that are there are asked for
        if render.shape != image.shape:
            raise BenchError(
                f"The left render of frame {number} in {run.path} is {render.shape[1]}x{render.shape[0]} pixels, "
                f"the data set's image {image.shape[1]}x{image.shape[0]}. Are its files those of the run?"
            )
        asked = [dialect for dialect in DIALECTS if number in views[dialect.name]]
        depth, reference = run.depth("left", number), run.dataset.lidar_depth(position)
        found = score_view(asked, render, image, depth, reference, lpips, known_lpips.get(number))
        for name, values in found.items():
            scores[name].append(values)
    run.report_progress("dialects", len(numbers), len(numbers))
    return scores


def _known_lpips(run: SavedRun) -> dict[int, float]:
    """LPIPS of left views by number, where the evaluator ``image`` came first: it is most of the time of a view."""
    table = run.per_frame()
    if "lpips" not in table:
        return {}
    left = table[(table["view"] == "left") & table["lpips"].notna()]
    return dict(zip(left["number"].tolist(), left["lpips"].tolist(), strict=True))


def _ate(run: SavedRun, dialect: Dialect) -> float | str:
    found = estimate_and_truth(run)
    if isinstance(found, str):
        return found
    return dialect.ate_m(*found, np.array(run.numbers("left", "train"), dtype=np.int64))


def _gaps(dialect: Dialect, scores: Sequence[Scores]) -> list[str]:
    """Why metrics of a dialect are missing, or are means of fewer views than there are."""
    if not scores:
        return ["none of the run's left views is one that it scores"]
    reasons = []
    for name, what in (("psnr_db", "PSNR"), ("ssim", "SSIM"), ("depth_l1_cm", "Depth-L1")):
        if name == "depth_l1_cm" and dialect.depth_l1_m is None:
            continue
        values = [score[name] for score in scores]
        missing = sum(value is None or bool(np.isnan(value)) for value in values)
        if missing:
            reasons.append(f"{missing} of {len(scores)} views have no {what}")
        if float("inf") in values:
            reasons.append(f"{values.count(float('inf'))} of {len(scores)} views have an infinite {what}")
    return reasons


def _mean(values: Sequence[float | None]) -> float | None:
    """Of the known values; None where there are none, and where one is infinite."""
    known = [value for value in values if value is not None and not np.isnan(value)]
    return float(np.mean(known)) if known and np.isfinite(known).all() else None
