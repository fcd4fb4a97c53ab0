"""Contract of an evaluator: a saved run in, numbers out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from bench.contracts.metric import Metric
from bench.contracts.saved_run import SavedRun, SavedView
from bench.runs.folder import View

ViewScores = Mapping[tuple[View, int], dict[str, Any]]
"""What an evaluator said of views, by camera and frame number, in the order of ``SavedRun.views``."""


class Evaluator(ABC):
    """Scores a saved run folder. It never sees a live mapper, so an external system's output is scored by the same
    code, and it never sees what another evaluator found: they run in any order."""

    metrics: tuple[Metric, ...] = ()
    """Its numbers that tables show; others that it returns stand in ``metrics.json`` alone."""

    @abstractmethod
    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """The part of ``metrics.json`` that this evaluator knows, as a nested dict.

        For example ``{"trajectory": {"ate_rmse_m": 0.12}}`` or ``{"views": {"left": {"psnr_db": 24.1}}}``; the parts of
        all evaluators are merged. Per-frame values go to ``run.per_frame`` (see ``SavedRun.add_per_frame``).
        A metric that can't be computed is None, with the reason in ``{"notes": {"lpips": "no weights found: ..."}}``.
        """


class ViewEvaluator(Evaluator):
    """An evaluator of pictures: ``start``, then ``view`` for each saved view, then ``finish``.

    All evaluators of this kind share one pass over the views, so that each picture is decoded once. Frames are scored
    on all cores, and what ``view`` gave is on disk from then on: a scoring that was stopped goes on after it.
    """

    @abstractmethod
    def start(self, run: SavedRun) -> None:
        """Get ready for this run, before its first view."""

    @abstractmethod
    def view(self, view: SavedView) -> dict[str, Any] | None:
        """Scores of one view, plain data that JSON holds (NaN too), or None; ask it only for what is needed.

        Called from several threads at once, in any order, and not for views that a stopped scoring had done: it may
        depend on the view, the run and the settings, and must change nothing.
        """

    @abstractmethod
    def finish(self, scores: ViewScores) -> dict[str, Any]:
        """What ``evaluate`` returns, from what ``view`` gave of each view; also for a run without views."""

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """Score the run alone, in a pass of its own."""
        self.start(run)
        found = {(view.camera, view.number): self.view(view) for view in run.views()}
        return self.finish({view: scores for view, scores in found.items() if scores is not None})
