"""A stereo plugin scored as stereo on the frames of a data set: errors, time, memory."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

from bench.contracts.dataset import Dataset
from bench.contracts.stereo import DepthSource
from bench.errors import BenchError
from bench.evaluation.disparity import (
    DisparityScore,
    disparity_of_depth,
    score_disparity,
    visible_returns,
)
from bench.runs.memory import PeakMemory
from bench.types import Map

# Called as each image is done: images done, images in all.
Progress = Callable[[int, int], None]

TRUE_DISPARITY = "disparities of the data set"
LIDAR = "LiDAR, less the returns hidden from the camera"


@dataclass(frozen=True)
class ImageScore:
    """What one image scored, and the milliseconds that its depth took."""

    number: int
    score: DisparityScore
    ms: float


@dataclass(frozen=True)
class BackboneScore:
    """What a backbone scored on a data set; ``truth`` says in words what it was compared with.

    ``peak_memory_gb`` is that of the whole process, or of the GPU where CUDA is in use, in GB of 1e9 bytes.
    """

    dataset: str
    truth: str
    images: tuple[ImageScore, ...]
    peak_memory_gb: float

    @property
    def pooled(self) -> DisparityScore:
        """All images added up, so that each pixel counts the same, as in KITTI's benchmark."""
        return sum((image.score for image in self.images), DisparityScore())

    @property
    def median_ms(self) -> float:
        """Milliseconds per frame: the median over the images."""
        return statistics.median(image.ms for image in self.images)

    def image_mean(self, of: Callable[[DisparityScore], float | None]) -> float | None:
        """Mean over the images of one of their figures, so that each image counts the same; None where none has it."""
        values = [value for image in self.images if (value := of(image.score)) is not None]
        return statistics.fmean(values) if values else None


def truth_of(dataset: Dataset, position: int) -> tuple[Map, str] | None:
    """Disparity (H, W) px, NaN where unknown, that a frame is scored against, and what it is; None where it has none.

    The data set's own disparities, else projected LiDAR.
    """
    disparity = dataset.true_disparity(position)
    if disparity is not None:
        return disparity, TRUE_DISPARITY
    lidar = dataset.lidar_depth(position)
    if lidar is None:
        return None
    return disparity_of_depth(visible_returns(lidar), dataset.camera_of(position)), LIDAR


def require_truth(dataset: Dataset) -> None:
    """Raise ``BenchError`` when no frame can be scored; looks no further than to the first that can."""
    if all(truth_of(dataset, position) is None for position in range(len(dataset))):
        raise BenchError(
            f"{dataset.label} has neither disparities nor LiDAR to score stereo against. Choose dataset=kitti2015, "
            "dataset=street, or frames of dataset=kitti that have a velodyne scan."
        )


def score_backbone(
    dataset: Dataset, source: DepthSource, warm_up: int = 1, on_progress: Progress | None = None
) -> BackboneScore:
    """Score ``source`` on every frame that has a truth; raises ``BenchError`` when none has.

    The first of them is done ``warm_up`` times beforehand, untimed: libraries choose their kernels then. Pairs of a
    data set that is no sequence are each begun anew.
    """
    memory = PeakMemory()
    images: list[ImageScore] = []
    what = ""
    for position in range(len(dataset)):
        found = truth_of(dataset, position)
        if found is not None:
            truth, what = found
            images.append(_score_image(dataset, source, position, truth, 0 if images else warm_up, not images))
        if on_progress is not None:
            on_progress(position + 1, len(dataset))
    if not images:
        require_truth(dataset)
    return BackboneScore(dataset.label, what, tuple(images), memory.peak_gb())


def _score_image(
    dataset: Dataset, source: DepthSource, position: int, truth: Map, warm_up: int, is_first: bool
) -> ImageScore:
    frame, camera = dataset.frame(position), dataset.camera_of(position)
    for _ in range(warm_up):
        source.start(dataset)
        source.depth(frame, position, camera)
    if is_first or not dataset.is_sequence:
        source.start(dataset)
    start = time.perf_counter()
    depth = source.depth(frame, position, camera).depth
    ms = 1e3 * (time.perf_counter() - start)
    return ImageScore(frame.number, score_disparity(disparity_of_depth(depth, camera), truth), ms)
