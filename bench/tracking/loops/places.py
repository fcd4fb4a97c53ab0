"""Places that were seen, and which of them a new one looks like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.io.torch_files import from_state, to_state
from bench.tracking.descriptors import Descriptors, Ints
from bench.tracking.features import Features
from bench.tracking.growing import Archive
from bench.tracking.local_map import View
from bench.tracking.loops.vocabulary import Vocabulary
from bench.tracking.matching import expand_ranges
from bench.tracking.pose_optimization import Observations
from bench.types import Float, Mask, StereoCamera

BLOCK = 128
"""Places that are kept together: their words are gathered before they are sorted into postings."""


@dataclass(frozen=True)
class Place:
    """What a keyframe leaves behind: its N keypoints with stereo depth, 45 bytes each (77 with descriptors of int8).

    ``xy`` (N, 2) float32 pixels, ``octave`` (N,) int8, ``disparity`` (N,) float32 pixels, ``descriptors`` (N, W).
    Octaves differ by ``scale_factor``; keypoints are off by ``sigma_px`` pixels of theirs. Disparities below
    ``least_disparity`` place points but are no measurements (see ``View``).
    """

    keyframe: int
    xy: npt.NDArray[np.float32]
    octave: npt.NDArray[np.int8]
    disparity: npt.NDArray[np.float32]
    descriptors: Descriptors
    least_disparity: float
    scale_factor: float
    sigma_px: float = 1.0

    @classmethod
    def of(cls, view: View, keyframe: int, least_disparity: float, scale_factor: float, sigma_px: float = 1.0) -> Place:
        """The keypoints of a view whose disparity is at least ``least_disparity`` pixels (farther ones say little)."""
        with np.errstate(invalid="ignore"):
            near = np.flatnonzero(view.disparity >= least_disparity)
        return cls(
            keyframe,
            view.features.xy[near].astype(np.float32),
            view.features.octave[near].astype(np.int8),
            view.disparity[near].astype(np.float32),
            view.features.descriptors[near],
            view.least_disparity,
            scale_factor,
            sigma_px,
        )

    def __len__(self) -> int:
        return len(self.xy)

    @property
    def features(self) -> Features:
        """The keypoints (N) in the types of the tracker."""
        return Features(self.xy.astype(np.float64), self.octave.astype(np.int64), self.descriptors)

    def points(self, camera: StereoCamera, chosen: Ints) -> Float:
        """Positions (M, 3), in metres in the camera's frame, of the chosen (M,) keypoints."""
        z = camera.fx * camera.baseline / self.disparity[chosen].astype(np.float64)
        ray = (self.xy[chosen].astype(np.float64) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return np.column_stack([ray * z[:, None], z])

    def observations(self, chosen: Ints) -> Observations:
        """Measurements of the chosen (M,) keypoints."""
        disparity = self.disparity[chosen].astype(np.float64)
        disparity = np.where(disparity < self.least_disparity, np.nan, disparity)
        weight = np.asarray(self.scale_factor ** (-2.0 * self.octave[chosen]) / self.sigma_px**2, dtype=np.float64)
        return Observations(self.xy[chosen].astype(np.float64), disparity, weight)


@dataclass(frozen=True)
class WordVector:
    """Weights of the words in one image: ``words`` (M,) ascending, ``values`` (M,) float32 with sum 1."""

    words: Ints
    values: npt.NDArray[np.float32]


def word_vector(vocabulary: Vocabulary, descriptors: Descriptors) -> WordVector:
    """tf-idf weights of the words of descriptors (N, W), scaled to sum 1 (Galvez-Lopez and Tardos, T-RO 2012)."""
    words, count = np.unique(vocabulary.words(descriptors), return_counts=True)
    values = count * vocabulary.word_idf[words]
    return WordVector(words, (values / max(values.sum(), 1e-300)).astype(np.float32))


def similarity(a: WordVector, b: WordVector) -> float:
    """1 - |a - b|_1 / 2, from 0 (no common word) to 1 (the same weights); of vectors with sum 1 it's sum min(a, b)."""
    _, at_a, at_b = np.intersect1d(a.words, b.words, assume_unique=True, return_indices=True)
    return float(np.minimum(a.values[at_a], b.values[at_b]).sum())


@dataclass(frozen=True)
class _Postings:
    """Words of a block of places, sorted by word: those of word w are at ``start[w]`` to ``start[w + 1]``."""

    start: npt.NDArray[np.int32]
    place: npt.NDArray[np.int32]
    values: npt.NDArray[np.float32]

    def ranges(self, words: Ints) -> tuple[Ints, Ints]:
        """Where the postings of words (M,) start and stop."""
        return self.start[words].astype(np.int64), self.start[words + 1].astype(np.int64)


class PlaceIndex:
    """Inverted index over the word vectors of all places: 8 bytes for each word of each place, most in the archive."""

    def __init__(self, words: int, archive: Archive) -> None:
        """``words`` is the size of the vocabulary."""
        self._size = words
        self._archive = archive
        self._blocks: list[_Postings] = []
        self._open: list[WordVector] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, vector: WordVector) -> None:
        """Make a place known; its number is the count of places before."""
        self._open.append(vector)
        self._count += 1
        if len(self._open) == BLOCK:
            first = self._count - BLOCK
            postings = self._sorted(self._open, first)
            self._blocks.append(_Postings(**self._archive.put(f"words-{first}", vars(postings))))
            self._open = []

    def state(self) -> dict[str, Any]:
        """For a checkpoint: what is not in the archive."""
        return {"archived": len(self._blocks) * BLOCK, "open": [to_state(vars(vector)) for vector in self._open]}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        firsts = range(0, state["archived"], BLOCK)
        self._blocks = [_Postings(**self._archive.get(f"words-{first}")) for first in firsts]
        self._open = [WordVector(**from_state(vector)) for vector in state["open"]]
        self._count = state["archived"] + len(self._open)

    def scores(self, vector: WordVector) -> Float:
        """``similarity`` of the vector with every place (n,)."""
        scores = np.zeros(self._count)
        for block in self._blocks:
            owner, entry = expand_ranges(*block.ranges(vector.words))
            common = np.minimum(vector.values[owner], block.values[entry])
            scores += np.bincount(block.place[entry], weights=common, minlength=self._count)
        if self._open:
            dense = np.zeros(self._size, dtype=np.float32)
            dense[vector.words] = vector.values
            words = np.concatenate([place.words for place in self._open])
            common = np.minimum(dense[words], np.concatenate([place.values for place in self._open]))
            owner = np.repeat(np.arange(-len(self._open), 0), [len(place.words) for place in self._open])
            scores += np.bincount(self._count + owner, weights=common, minlength=self._count)
        return scores

    def _sorted(self, vectors: list[WordVector], first: int) -> _Postings:
        words = np.concatenate([vector.words for vector in vectors])
        place = np.repeat(np.arange(first, first + len(vectors)), [len(vector.words) for vector in vectors])
        order = np.argsort(words, kind="stable")
        start = np.searchsorted(words[order], np.arange(self._size + 1))
        values = np.concatenate([vector.values for vector in vectors])[order]
        return _Postings(start.astype(np.int32), place[order].astype(np.int32), values)


def best_places(scores: Float, allowed: Mask, least: float, groups: int, gap: int = 2) -> Ints:
    """The best place of each of the best groups of neighbouring places, best group first; at most ``groups``.

    Places (n,) that are ``allowed`` and score ``least`` or more form a group when at most ``gap`` numbers lie from one
    to the next; a group's score is the sum of its places' scores, because neighbours see the same things.
    """
    found = np.flatnonzero(allowed & (scores >= least) & (scores > 0))
    if len(found) == 0:
        return found
    start = np.flatnonzero(np.diff(found, prepend=-gap - 1) > gap)
    group_score = np.add.reduceat(scores[found], start)
    order = np.argsort(-group_score, kind="stable")[:groups]
    stop = np.append(start[1:], len(found))
    return np.array([found[start[g] + scores[found[start[g] : stop[g]]].argmax()] for g in order], dtype=np.int64)
