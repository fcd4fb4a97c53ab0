"""The LPIPS metric that a saved run asks for, or why it can't be had."""

from __future__ import annotations

from typing import Any

from bench.evaluation.lpips_metric import MINIMUM_SIDE, Lpips, find_alexnet_weights
from bench.evaluation.saved_run import SavedRun
from bench.runs.provenance import sha256_of


def lpips_of(run: SavedRun) -> tuple[Lpips | None, dict[str, Any]]:
    """The metric, or None, with what ``metrics.json`` should say about it; its weights are noted in ``run.weights``.

    Raises ``BenchError`` for a weights file that is given and is not there, or is damaged.
    """
    if not run.protocol.lpips:
        return None, {"notes": {"lpips": "switched off by protocol.lpips=false"}}
    camera = run.dataset.camera
    if min(camera.width, camera.height) < MINIMUM_SIDE:
        return None, {"notes": {"lpips": f"images of {camera.width}x{camera.height} pixels are too small for AlexNet"}}
    found = find_alexnet_weights(run.protocol.lpips_weights)
    if isinstance(found, str):
        return None, {"notes": {"lpips": found}}
    run.weights["lpips"] = found.path
    return Lpips(found), {"protocol": {"lpips_weights_sha256": sha256_of(found.path)}}
