"""Descriptors of a data set's frames, to train a vocabulary on."""

from __future__ import annotations

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.io.images import grey
from bench.tracking.descriptors import Descriptors
from bench.tracking.features import OrbExtractor

DEFAULT_FRAMES = 30
DEFAULT_FEATURES = 1000


def descriptors_of(
    dataset: Dataset, frames: int = DEFAULT_FRAMES, features: int = DEFAULT_FEATURES
) -> list[Descriptors]:
    """ORB descriptors, each (N, 4) uint64, of the left images of up to ``frames`` frames spread over the sequence.

    Raises ``BenchError`` for numbers below 1.
    """
    for what, value in (("frames", frames), ("features", features)):
        if value < 1:
            raise BenchError(f"A vocabulary can't be trained from {value} {what}; give 1 or more.")
    positions = np.unique(np.linspace(0, len(dataset) - 1, min(frames, len(dataset))).round().astype(np.int64))
    extractor = OrbExtractor(features)
    return [extractor.extract(grey(dataset.frame(position).left))[0].descriptors for position in positions.tolist()]
