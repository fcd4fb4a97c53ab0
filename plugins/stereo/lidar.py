"""The paper's LiDAR variant: projected scans in place of stereo depth."""

from __future__ import annotations

from bench.contracts.dataset import Dataset
from bench.contracts.stereo import DepthSource
from bench.errors import BenchError
from bench.registry import register
from bench.types import DepthMap, StereoCamera, StereoFrame


@register("stereo", "lidar")
class Lidar(DepthSource):
    """Depth from the data set's projected LiDAR (the paper's LiDAR variant)."""

    def __init__(self, config: object) -> None:
        """``config`` has no settings."""
        self._dataset: Dataset | None = None

    def start(self, dataset: Dataset) -> None:
        """Remember the sequence; raises ``BenchError`` if it has no LiDAR for its first frame."""
        self._dataset = dataset
        self._lookup(dataset, 0)

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """The scan of this frame in the left image; raises ``BenchError`` where the data set has none."""
        if self._dataset is None:
            raise RuntimeError("Lidar.start(dataset) comes before Lidar.depth")
        return self._lookup(self._dataset, position)

    def _lookup(self, dataset: Dataset, position: int) -> DepthMap:
        depth = dataset.lidar_depth(position)
        if depth is None:
            raise BenchError(
                f"stereo=lidar: {dataset.label} has no LiDAR scan for frame {dataset.numbers[position]}. Add the "
                "scans, choose dataset.frames that have one, or another stereo plugin such as stereo=sgbm."
            )
        return DepthMap(depth, "lidar")
