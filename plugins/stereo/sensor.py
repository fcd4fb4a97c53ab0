"""Depth of an RGB-D camera in place of stereo depth."""

from __future__ import annotations

from bench.contracts.dataset import Dataset
from bench.registry import register
from bench.stereo.dataset_depth import DatasetDepth
from bench.types import Map


@register("stereo", "sensor")
class Sensor(DatasetDepth):
    """Depth from the data set's own depth images (RGB-D)."""

    source = "sensor"
    what = "depth image"
    instead = "Choose an RGB-D data set (dataset=tum_rgbd, replica) or another stereo plugin such as stereo=sgbm."

    def measured(self, dataset: Dataset, position: int) -> Map | None:
        """The depth image of this frame."""
        return dataset.sensor_depth(position)
