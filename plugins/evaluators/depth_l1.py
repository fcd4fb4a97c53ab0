"""Depth-L1 of rendered depth against LiDAR, or against a depth camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.contracts.evaluator import ViewEvaluator, ViewScores
from bench.contracts.metric import Metric
from bench.contracts.saved_run import GROUPS, VIEW_OF_GROUP, SavedRun, SavedView
from bench.evaluation.depth import depth_l1_cm, depth_reference
from bench.registry import PluginConfig, register


@register("evaluator", "depth_l1")
class DepthL1Evaluator(ViewEvaluator):
    """Depth-L1 against projected LiDAR, else sensor depth, in the left views, centimetres."""

    metrics = (Metric("depth_l1_cm", "Depth-L1", "cm", "lower", 1, "views.left.depth_l1_cm", "always", order=43),)

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def start(self, run: SavedRun) -> None:
        """There is nothing to get ready."""
        self._run = run

    def view(self, view: SavedView) -> dict[str, Any] | None:
        """Depth-L1 of a left view and of how many pixels, if it has depth and the data set knows some in range."""
        protocol = self._run.protocol
        reference = depth_reference(view, protocol)
        depth = view.depth if reference is not None else None
        if reference is None or depth is None:
            return None
        error, pixels = depth_l1_cm(depth, reference, protocol.depth_min_m, protocol.depth_max_m)
        return {"depth_l1_cm": error, "depth_pixels": pixels} if pixels else None

    def finish(self, scores: ViewScores) -> dict[str, Any]:
        """``views.<group>.depth_l1_cm`` of the groups of left views: mean over frames of the frame's mean error.

        Depth is known in the left image, so right views have none. Frames without any in range don't enter; a note says
        how many did when some lack it.
        """
        rendered = set(self._run.rendered("left", "depth"))
        for view, values in scores.items():
            self._run.add_per_frame(*view, **values)
        views: dict[str, Any] = {}
        for group in GROUPS:
            if VIEW_OF_GROUP[group] != "left":
                continue
            of_group = [number for number in self._run.numbers("left", group) if number in rendered]
            errors = [scores["left", each]["depth_l1_cm"] for each in of_group if ("left", each) in scores]
            if of_group:
                views[group] = {"depth_l1_cm": float(np.mean(errors)) if errors else None}
        if rendered and len(scores) < len(rendered):
            has_sensor = self._run.dataset.sensor_depth(0) is not None
            what = "LiDAR returns or sensor depth" if has_sensor else "LiDAR returns"
            note = f"{len(scores)} of {len(rendered)} left views have {what} in range"
            return {"views": views, "notes": {"depth_l1": note}}
        return {"views": views}
