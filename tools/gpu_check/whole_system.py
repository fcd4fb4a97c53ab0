"""Frames per second of the whole system, on KITTI 06 where it is at hand, else on the built-in street."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.config import compose_run
from bench.evaluation.run_evaluators import evaluate_run
from bench.override_text import quoted
from bench.slam.run import run_system
from tools.gpu_check import kernels
from tools.gpu_check.device import yardstick

ROWS = (("bgs_slam_fast", "gsplat"), ("bgs_slam", "gsplat"), ("bgs_slam_fast", "cpu"))
FRAMES = 10


def frames_of(data: str | None, count: int = FRAMES) -> list[str]:
    """The overrides that choose the frames; ``data`` is a folder with ``kitti_odometry``, as for the tests."""
    root = Path(data).resolve() / "kitti_odometry" if data else None
    if root is not None and (root / "sequences" / "06").is_dir():
        return ["dataset=kitti", f"dataset.root={quoted(root)}", "dataset.sequence='06'", f"dataset.frames=0:{count}"]
    return ["dataset=street", f"dataset.frames={count}"]


def measure(
    rows: Sequence[tuple[str, str]] = ROWS, frames: Sequence[str] | None = None, more: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Yields the rows so far, one for each system and rasterizer: speed, quality, memory, and the yardstick then."""
    frames = frames_of(os.environ.get("BGS_TEST_DATA")) if frames is None else frames
    for rasterizer in sorted({rasterizer for _, rasterizer in rows}):
        list(kernels.measure(rasterizer))  # loaded before the first frame
    measured: list[dict[str, Any]] = []
    for system, rasterizer in rows:
        given = (f"system={system}", f"mapper.rasterizer={rasterizer}", *frames, *more)
        measured.append({"system": system, "rasterizer": rasterizer, **yardstick(), **_run(given)})
        shown = [each for each in frames if not each.startswith("dataset.root=")]
        yield {"frames": " ".join(shown), "rows": measured}


def _run(overrides: Sequence[str]) -> dict[str, Any]:
    with TemporaryDirectory(prefix="bgs-gpu-") as folder:
        output = f"output={quoted(Path(folder) / 'run')}"
        config = compose_run([*overrides, "cache.enabled=false", "protocol.lpips=false", output])
        metrics = evaluate_run(run_system(config).path)
    resources, left = metrics["resources"], metrics["views"]["left"]
    return {
        "frames_per_s": 1.0 / resources["wall_s_per_frame"],
        **{key: value for key, value in resources.items() if key.endswith("_s_per_frame")},
        "peak_memory_gb": resources["peak_memory_gb"],
        "gaussians": metrics["map"]["gaussians"],
        "psnr_db": left["psnr_db"],
        "ssim": left["ssim"],
        "depth_l1_cm": left.get("depth_l1_cm"),
        "ate_rmse_m": metrics["trajectory"]["ate_rmse_m"],
    }
