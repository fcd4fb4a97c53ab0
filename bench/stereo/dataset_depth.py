"""Depth that a data set has of its own, in place of a stereo backbone's."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from bench.contracts.dataset import Dataset
from bench.contracts.stereo import DepthSource
from bench.errors import BenchError
from bench.types import DepthMap, Map, StereoCamera, StereoFrame


class DatasetDepth(DepthSource):
    """An author writes ``measured``, and for frames without depth ``what`` they lack and ``instead``, a sentence."""

    source: ClassVar[str]
    what: ClassVar[str]
    instead: ClassVar[str]

    def __init__(self, config: object) -> None:
        """``config`` has no settings."""
        self._dataset: Dataset | None = None

    @abstractmethod
    def measured(self, dataset: Dataset, position: int) -> Map | None:
        """Depth (H, W) of the left image in metres, NaN where unknown; None where there is none of this frame."""

    def start(self, dataset: Dataset) -> None:
        """Remember the sequence; raises ``BenchError`` if it has no depth of its first frame."""
        self._dataset = dataset
        self._lookup(dataset, 0)

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        """The data set's depth of this frame; raises ``BenchError`` where it has none."""
        if self._dataset is None:
            raise RuntimeError(f"{type(self).__name__}.start(dataset) comes before {type(self).__name__}.depth")
        return self._lookup(self._dataset, position)

    def _lookup(self, dataset: Dataset, position: int) -> DepthMap:
        depth = self.measured(dataset, position)
        if depth is None:
            lacks = f"{dataset.label} has no {self.what} for frame {dataset.numbers[position]}"
            raise BenchError(f"stereo={self.source}: {lacks}. {self.instead}")
        return DepthMap(depth, self.source)
