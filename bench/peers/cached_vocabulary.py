"""A DBoW2 vocabulary made once for a sequence and kept in the user's cache folder."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

import pooch

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.io.atomic import atomic_path
from bench.tracking.loops.dbow2_text import write_dbow2
from bench.tracking.loops.training_images import descriptors_of
from bench.tracking.loops.vocabulary import train

log = logging.getLogger(__name__)

# Part of the files' names: raise it when training changes.
_RECIPE = 1
BRANCHING = 10
DEPTH = 6
"""As the official vocabulary. ORB-SLAM3 matches within groups of the tree that lie four levels above the leaves: with a
tree of depth 4 that is one group, and the error on KITTI 06 is twice as large (0.09 m for 0.045 m)."""


def dbow2_vocabulary_of(dataset: Dataset) -> Path:
    """File of a vocabulary trained from frames of ``dataset``; trains and writes it the first time.

    The file is named by the sequence's label, frame numbers and first image. Raises ``BenchError`` when the cache
    folder can't be written, or the frames have too little texture.
    """
    folder = Path(pooch.os_cache("bgs-bench"))
    path = folder / f"orb-vocabulary-{_identity(dataset)}.txt"
    if path.is_file():
        return path
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(
            f"The cache folder {folder} can't be made ({error.strerror}). Set $XDG_CACHE_HOME to a folder that can be "
            "written, or tracker.vocabulary to a DBoW2 file."
        ) from error
    log.info("training a vocabulary from %s, once; it is kept in %s", dataset.label, path)
    vocabulary = train(descriptors_of(dataset), BRANCHING, DEPTH)
    with atomic_path(path) as temporary:
        write_dbow2(temporary, vocabulary)
    return path


def _identity(dataset: Dataset) -> str:
    digest = hashlib.sha256(f"{_RECIPE} {dataset.label} {dataset.numbers}".encode())
    digest.update(dataset.frame(0).left.tobytes())
    return digest.hexdigest()[:16]
