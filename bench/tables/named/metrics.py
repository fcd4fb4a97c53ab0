"""The metrics that a table may have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Metric:
    """A metric by its key in run folders and in published CSV files; ``decimals`` are those of our numbers.

    ``of_part`` False: what a run measured before it stopped early is no value of it (peak memory).
    """

    key: str
    title: str
    unit: str
    better: Literal["lower", "higher"]
    decimals: int
    of_part: bool = True


METRICS = {
    metric.key: metric
    for metric in (
        Metric("ate_rmse_m", "ATE", "m", "lower", 3),
        Metric("psnr_db", "PSNR", "dB", "higher", 2),
        Metric("ssim", "SSIM", "", "higher", 3),
        Metric("lpips", "LPIPS", "", "lower", 3),
        Metric("depth_l1_cm", "Depth-L1", "cm", "lower", 1),
        Metric("peak_memory_gb", "Memory", "GB", "lower", 2, of_part=False),
        Metric("tracking_s_per_frame", "Tracking", "s/frame", "lower", 3),
        Metric("stereo_s_per_frame", "Stereo", "s/frame", "lower", 3),
        Metric("mapping_s_per_frame", "Mapping", "s/frame", "lower", 3),
        Metric("wall_s_per_frame", "Wall time", "s/frame", "lower", 3),
    )
}
