"""The saved views and trajectory as the evaluation code of other systems scores them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from bench.contracts.evaluator import ViewEvaluator, ViewScores
from bench.contracts.metric import Metric
from bench.contracts.saved_run import LpipsMetric, SavedRun, SavedView
from bench.errors import require_choice
from bench.evaluation.dialects.catalogue import DIALECTS
from bench.evaluation.dialects.dialect import Dialect
from bench.evaluation.dialects.view import METRICS, Scores, score_view
from bench.evaluation.run_trajectory import estimate_and_truth
from bench.evaluation.trajectory import common_frames
from bench.registry import PluginConfig, register

VIEWS = ("own", "all")
_METRICS: tuple[tuple[str, str, str, Literal["higher", "lower"], int], ...] = (
    ("psnr_db", "PSNR", "dB", "higher", 2),
    ("ssim", "SSIM", "", "higher", 3),
    ("lpips", "LPIPS", "", "lower", 3),
    ("depth_l1_cm", "Depth-L1", "cm", "lower", 1),
    ("ate_m", "ATE", "m", "lower", 3),
)


@dataclass(frozen=True)
class DialectsConfig(PluginConfig):
    """Which views are scored."""

    views: str = "own"
    """own = the left views that each dialect chooses, all = every left view under each of them."""

    def __post_init__(self) -> None:
        require_choice("evaluator.dialects.views", self.views, VIEWS)


@register("evaluator", "dialects", config=DialectsConfig)
class DialectsEvaluator(ViewEvaluator):
    """PSNR, SSIM, LPIPS, Depth-L1 and ATE by the rules of SplaTAM, MonoGS, Point-SLAM and LoopSplat."""

    metrics = tuple(
        Metric(f"{dialect.name}_{key}", f"{title} ({dialect.name})", unit, better, decimals,
               f"dialects.{dialect.name}.{key}", "never")
        for dialect in DIALECTS
        for key, title, unit, better, decimals in _METRICS
    )  # fmt: skip

    def __init__(self, config: DialectsConfig) -> None:
        self.config = config

    def start(self, run: SavedRun) -> None:
        """Choose the views that each dialect scores."""
        self._run = run
        self._views = _views_of_each(run, self.config.views)
        self._lpips = run.lpips if any(self._views.values()) else LpipsMetric(None)

    def view(self, view: SavedView) -> dict[str, Any] | None:
        """Scores of a left view under each of the dialects that chose it."""
        asked = [dialect for dialect in DIALECTS if view.number in self._views[dialect.name]]
        if view.camera != "left" or not asked or view.render is None:
            return None
        return score_view(asked, view, view.render, self._lpips.distance)

    def finish(self, scores: ViewScores) -> dict[str, Any]:
        """``dialects.<name>`` with n_views, the means of ``METRICS`` over them, ate_m, and a stamp that says how.

        The images are the saved 8-bit ones, LiDAR or else sensor depth is the reference, and the rendered depth is the
        one that the run saved. What can't be computed is None, with the reason in ``notes.dialects``.
        """
        run, about_lpips = self._run, self._lpips.about
        weights = about_lpips.get("protocol", {})
        parts, notes = {}, []
        for dialect in DIALECTS:
            of_dialect: list[Scores] = [each[dialect.name] for each in scores.values() if dialect.name in each]
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
        stamp |= {"reference_depth": "LiDAR, else sensor depth", "rendered_depth": run.protocol.rendered_depth}
        return stamp if self.config.views == "own" else stamp | {"views": "all left views"}


def _views_of_each(run: SavedRun, which: str) -> dict[str, set[int]]:
    """Numbers of the rendered left views that each dialect scores."""
    rendered = run.rendered("left")
    if not rendered:
        return {dialect.name: set() for dialect in DIALECTS}
    if which == "all":
        return {dialect.name: set(rendered) for dialect in DIALECTS}
    positions = np.searchsorted(run.dataset.numbers, rendered)
    mapped = np.isin(rendered, run.numbers("left", "train"))
    frames = len(run.dataset)
    return {d.name: set(np.array(rendered)[d.scores_view(positions, mapped, frames)].tolist()) for d in DIALECTS}


def _ate(run: SavedRun, dialect: Dialect) -> float | str:
    """Of poses relative to the first frame that both have, as SplaTAM has them; others do not care."""
    found = estimate_and_truth(run)
    if isinstance(found, str):
        return found
    _, *rows = common_frames(*found)
    relative = [
        replace(poses, T_world_cam=np.linalg.inv(poses.T_world_cam[of_both[0]]) @ poses.T_world_cam)
        if len(of_both)
        else poses
        for poses, of_both in zip(found, rows, strict=True)
    ]
    return dialect.ate_m(relative[0], relative[1], np.array(run.numbers("left", "train"), dtype=np.int64))


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
