"""Depth-L1 of rendered depth against LiDAR."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.contracts.evaluator import Evaluator
from bench.evaluation.depth import depth_l1_cm
from bench.evaluation.lidar_occlusion import unoccluded
from bench.evaluation.saved_run import GROUPS, VIEW_OF_GROUP, SavedRun
from bench.registry import PluginConfig, register


@register("evaluator", "depth_l1")
class DepthL1Evaluator(Evaluator):
    """Depth-L1 against projected LiDAR in the left views, centimetres."""

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def evaluate(self, run: SavedRun) -> dict[str, Any]:
        """``views.<group>.depth_l1_cm`` of the groups of left views: mean over frames of the frame's mean error.

        LiDAR is projected into the left image, so right views have none. Frames without a return in range don't enter;
        a note says how many did when some lack it.
        """
        errors = _errors_of_left_views(run)
        rendered = run.rendered("left", "depth")
        views: dict[str, Any] = {}
        for group in GROUPS:
            if VIEW_OF_GROUP[group] != "left":
                continue
            of_group = [number for number in run.numbers("left", group) if number in set(rendered)]
            values = [errors[number] for number in of_group if number in errors]
            if of_group:
                views[group] = {"depth_l1_cm": float(np.mean(values)) if values else None}
        if rendered and len(errors) < len(rendered):
            note = f"{len(errors)} of {len(rendered)} left views have LiDAR returns in range"
            return {"views": views, "notes": {"depth_l1": note}}
        return {"views": views}


def _errors_of_left_views(run: SavedRun) -> dict[int, float]:
    """Depth-L1 in cm by frame number, of the rendered left views that have LiDAR returns."""
    position_of = {number: position for position, number in enumerate(run.dataset.numbers)}
    errors = {}
    numbers = run.rendered("left", "depth")
    for done, number in enumerate(numbers):
        run.report_progress("depth", done, len(numbers))
        lidar = run.dataset.lidar_depth(position_of[number])
        depth = run.depth("left", number) if lidar is not None else None
        if lidar is None or depth is None:
            continue
        if run.protocol.depth_mask == "unoccluded":
            lidar = np.where(unoccluded(lidar), lidar, np.float32(np.nan))
        error, pixels = depth_l1_cm(depth, lidar, run.protocol.depth_min_m, run.protocol.depth_max_m)
        if pixels:
            errors[number] = error
            run.add_per_frame("left", number, depth_l1_cm=error, lidar_pixels=pixels)
    run.report_progress("depth", len(numbers), len(numbers))
    return errors
