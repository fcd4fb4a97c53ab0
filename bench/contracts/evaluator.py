"""Contract of an evaluator: a saved run in, numbers out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from bench.evaluation.saved_run import SavedRun


class Evaluator(ABC):
    """Scores a saved run folder. It never sees a live mapper, so a foreign system's output is scored by the same
    code."""

    @abstractmethod
    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """The part of ``metrics.json`` that this evaluator knows, as a nested dict.

        For example ``{"trajectory": {"ate_rmse_m": 0.12}}`` or ``{"views": {"left": {"psnr_db": 24.1}}}``; the parts of
        all evaluators are merged. Per-frame values go to ``run.per_frame`` (see ``SavedRun.add_per_frame``).
        A metric that can't be computed is None, with the reason in ``{"notes": {"lpips": "no weights found: ..."}}``.
        """
