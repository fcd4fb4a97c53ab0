"""Contract of an evaluator: a saved run in, numbers out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from bench.contracts.metric import Metric
from bench.contracts.saved_run import SavedRun, SavedView


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

    All evaluators of this kind share one pass over the views, so that each picture is decoded once.
    """

    @abstractmethod
    def start(self, run: SavedRun) -> None:
        """Get ready for this run, before its first view."""

    @abstractmethod
    def view(self, view: SavedView) -> None:
        """Score one view; ask it only for what is needed. Views come as ``SavedRun.views`` gives them."""

    @abstractmethod
    def finish(self) -> dict[str, Any]:
        """What ``evaluate`` returns, after the last view; also for a run without views."""

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """Score the run alone, in a pass of its own."""
        self.start(run)
        for view in run.views():
            self.view(view)
        return self.finish()
