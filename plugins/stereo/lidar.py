"""The paper's LiDAR variant: projected scans in place of stereo depth."""

from __future__ import annotations

from bench.contracts.dataset import Dataset
from bench.registry import register
from bench.stereo.dataset_depth import DatasetDepth
from bench.types import Map


@register("stereo", "lidar")
class Lidar(DatasetDepth):
    """Depth from the data set's projected LiDAR (the paper's LiDAR variant)."""

    source = "lidar"
    what = "LiDAR scan"
    instead = "Add the scans, choose dataset.frames that have one, or another stereo plugin such as stereo=sgbm."

    def measured(self, dataset: Dataset, position: int) -> Map | None:
        """The scan of this frame in the left image."""
        return dataset.lidar_depth(position)
