"""PSNR and Depth-L1 by distance, and PSNR of the sky and of all that is not sky."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from bench.contracts.evaluator import ViewEvaluator, ViewScores
from bench.contracts.metric import Metric
from bench.contracts.saved_run import GROUPS, VIEW_OF_GROUP, SavedRun, SavedView
from bench.errors import BenchError
from bench.evaluation.depth import depth_l1_cm
from bench.evaluation.regions import distance_bins, psnr_where
from bench.registry import PluginConfig, register
from bench.types import Mask

Scores = dict[str, dict[str, float]]
"""Of one view: ``pixels``, ``psnr_db`` and where it has one ``depth_l1_cm``, by region."""


@dataclass(frozen=True)
class RegionsConfig(PluginConfig):
    """The distance bins."""

    edges_m: tuple[float, ...] = (0.0, 10.0, 30.0, 80.0)
    """Their edges in metres, increasing."""

    def __post_init__(self) -> None:
        edges = self.edges_m
        if len(edges) < 2 or edges[0] < 0 or any(low >= high for low, high in pairwise(edges)):
            raise BenchError(
                f"evaluator.regions.edges_m={list(edges)} must be two or more increasing distances (metres) from 0."
            )


@register("evaluator", "regions", config=RegionsConfig)
class RegionsEvaluator(ViewEvaluator):
    """PSNR and Depth-L1 in distance bins, PSNR in the sky and outside of it, of left views."""

    metrics = (
        Metric("sky_psnr_db", "Sky PSNR", "dB", "higher", 2, "regions.left.sky.psnr_db", "never"),
        Metric("not_sky_psnr_db", "PSNR without sky", "dB", "higher", 2, "regions.left.not_sky.psnr_db", "never"),
    )

    def __init__(self, config: RegionsConfig) -> None:
        self.config = config

    def start(self, run: SavedRun) -> None:
        """There is nothing to get ready."""
        self._run = run

    def view(self, view: SavedView) -> dict[str, Any] | None:
        """Scores of the regions of a left view."""
        render = view.render
        if view.camera != "left" or render is None:
            return None
        reference = view.true_depth
        if reference is None:
            reference = view.sensor_depth if view.lidar is None else view.lidar
        sky, depth = view.true_sky, view.depth
        bins = {} if reference is None else distance_bins(reference, self.config.edges_m)
        places: dict[str, Mask] = bins | ({} if sky is None else {"sky": sky, "not_sky": ~sky})
        scores: Scores = {}
        for name, where in places.items():
            pixels = int(np.count_nonzero(where))
            if not pixels:
                continue
            scores[name] = {"pixels": pixels, "psnr_db": psnr_where(render, view.image, where)}
            if name in bins and reference is not None and depth is not None:
                of_bin = np.where(where, reference, np.float32(np.nan))
                # The bin has chosen the pixels, from its lower edge on.
                error, _ = depth_l1_cm(depth, of_bin, -1.0, None)
                scores[name]["depth_l1_cm"] = error
        return scores

    def finish(self, scores: ViewScores) -> dict[str, Any]:
        """``regions.<group>.<region>`` with n views, pixels, psnr_db and depth_l1_cm (means of per-view values).

        Distance is the data set's true depth, LiDAR where it has none, sensor depth without either;
        ``regions.distance`` says which. Views
        without a pixel in a region don't enter there. Regions that no view has are absent, with a note for the sky.
        """
        run = self._run
        if not scores:
            return {"regions": {}, "notes": {"regions": "the run saved no left renders"}}
        regions: dict[str, Any] = {"distance": _source_of_distance(run)}
        for group in GROUPS:
            if VIEW_OF_GROUP[group] != "left":
                continue
            of_group = [scores["left", each] for each in run.numbers("left", group) if ("left", each) in scores]
            if of_group:
                regions[group] = _summarised(of_group)
        missing = [] if regions["distance"] else ["the data set knows no depth"]
        if run.dataset.true_sky(0) is None:
            missing.append("the data set does not know where its sky is")
        return {"regions": regions} | ({"notes": {"regions": "; ".join(missing)}} if missing else {})


def _source_of_distance(run: SavedRun) -> str | None:
    if run.dataset.true_depth(0) is not None:
        return "true depth"
    has_scans = any(run.dataset.lidar_depth(position) is not None for position in range(len(run.dataset)))
    return "LiDAR" if has_scans else "sensor depth" if run.dataset.sensor_depth(0) is not None else None


def _summarised(views: Sequence[Scores]) -> dict[str, Any]:
    """Means over the views that have the region, in the order in which regions appear; ``pixels`` is the sum."""
    by_region: dict[str, list[dict[str, float]]] = defaultdict(list)
    for view in views:
        for name, of_view in view.items():
            by_region[name].append(of_view)
    summary = {}
    for name, values in by_region.items():
        depth = [each["depth_l1_cm"] for each in values if "depth_l1_cm" in each]
        summary[name] = {
            "n": len(values),
            "pixels": int(sum(each["pixels"] for each in values)),
            "psnr_db": float(np.mean([each["psnr_db"] for each in values])),
        } | ({"depth_l1_cm": float(np.mean(depth))} if depth else {})
    return summary
