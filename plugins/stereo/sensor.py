"""RGB-D: the depth that comes with the data set, in place of stereo depth."""

from __future__ import annotations

from bench.contracts.dataset import Dataset
from bench.contracts.stereo import DepthSource
from bench.errors import BenchError
from bench.registry import register
from bench.types import DepthMap, StereoCamera, StereoFrame


@register("stereo", "sensor")
class Sensor(DepthSource):
    """Depth from the data set's own depth images (RGB-D)."""

    def __init__(self, config: object) -> None:
        """``config`` has no settings."""
        self._dataset: Dataset | None = None

    def start(self, dataset: Dataset) -> None:
        """Remember the sequence; raises ``BenchError`` if it has no depth for its first frame."""
        self._dataset = dataset
        self._lookup(dataset, 0)

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """The depth image of this frame; raises ``BenchError`` where the data set has none."""
        if self._dataset is None:
            raise RuntimeError("Sensor.start(dataset) comes before Sensor.depth")
        return self._lookup(self._dataset, position)

    def _lookup(self, dataset: Dataset, position: int) -> DepthMap:
        depth = dataset.sensor_depth(position)
        if depth is None:
            raise BenchError(
                f"stereo=sensor: {dataset.label} has no depth image for frame {dataset.numbers[position]}. Choose an "
                "RGB-D data set (dataset=tum_rgbd, replica) or another stereo plugin such as stereo=sgbm."
            )
        return DepthMap(depth, "sensor")
