"""Depth-L1 of rendered depth against LiDAR."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.contracts.evaluator import ViewEvaluator
from bench.contracts.metric import Metric
from bench.contracts.saved_run import GROUPS, VIEW_OF_GROUP, SavedRun, SavedView
from bench.evaluation.depth import depth_l1_cm
from bench.evaluation.lidar_occlusion import unoccluded
from bench.registry import PluginConfig, register


@register("evaluator", "depth_l1")
class DepthL1Evaluator(ViewEvaluator):
    """Depth-L1 against projected LiDAR in the left views, centimetres."""

    metrics = (Metric("depth_l1_cm", "Depth-L1", "cm", "lower", 1, "views.left.depth_l1_cm", "always", order=43),)

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def start(self, run: SavedRun) -> None:
        """Nothing is scored yet."""
        self._run = run
        self._errors: dict[int, tuple[float, int]] = {}

    def view(self, view: SavedView) -> None:
        """Score a left view, if it has depth and LiDAR returns in range."""
        lidar = view.lidar
        depth = view.depth if lidar is not None else None
        if lidar is None or depth is None:
            return
        protocol = self._run.protocol
        if protocol.depth_mask == "unoccluded":
            lidar = np.where(unoccluded(lidar), lidar, np.float32(np.nan))
        error, pixels = depth_l1_cm(depth, lidar, protocol.depth_min_m, protocol.depth_max_m)
        if pixels:
            self._errors[view.number] = error, pixels

    def finish(self) -> dict[str, Any]:
        """``views.<group>.depth_l1_cm`` of the groups of left views: mean over frames of the frame's mean error.

        LiDAR is projected into the left image, so right views have none. Frames without a return in range don't enter;
        a note says how many did when some lack it.
        """
        errors, rendered = self._errors, self._run.rendered("left", "depth")
        for number, (error, pixels) in errors.items():
            self._run.add_per_frame("left", number, depth_l1_cm=error, lidar_pixels=pixels)
        views: dict[str, Any] = {}
        for group in GROUPS:
            if VIEW_OF_GROUP[group] != "left":
                continue
            of_group = [number for number in self._run.numbers("left", group) if number in set(rendered)]
            values = [errors[number][0] for number in of_group if number in errors]
            if of_group:
                views[group] = {"depth_l1_cm": float(np.mean(values)) if values else None}
        if rendered and len(errors) < len(rendered):
            note = f"{len(errors)} of {len(rendered)} left views have LiDAR returns in range"
            return {"views": views, "notes": {"depth_l1": note}}
        return {"views": views}
