"""The LPIPS metric that a saved run asks for, or why it can't be had."""

from __future__ import annotations

from bench.contracts.saved_run import LpipsMetric, SavedRun
from bench.evaluation.lpips_metric import MINIMUM_SIDE, Lpips, find_alexnet_weights
from bench.runs.provenance import sha256_of


def lpips_of(run: SavedRun) -> LpipsMetric:
    """The metric or why there is none; its weights are noted in ``run.weights``.

    Raises ``BenchError`` for a weights file that is given and is not there, or is damaged.
    """
    if not run.protocol.lpips:
        return LpipsMetric(None, {"notes": {"lpips": "switched off by protocol.lpips=false"}})
    camera = run.dataset.camera
    if min(camera.width, camera.height) < MINIMUM_SIDE:
        reason = f"images of {camera.width}x{camera.height} pixels are too small for AlexNet"
        return LpipsMetric(None, {"notes": {"lpips": reason}})
    found = find_alexnet_weights(run.protocol.lpips_weights)
    if isinstance(found, str):
        return LpipsMetric(None, {"notes": {"lpips": found}})
    run.weights["lpips"] = found.path
    return LpipsMetric(Lpips(found), {"protocol": {"lpips_weights_sha256": sha256_of(found.path)}})
