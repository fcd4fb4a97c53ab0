"""A tree of visual words: what makes the descriptors of two images comparable without matching them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError, first_line
from bench.tracking.descriptors import Descriptors, Ints, are_descriptors, metric_of
from bench.types import Float, Mask

_FORMAT = "bgs-bench vocabulary 1"
_LLOYD_ITERATIONS = 4
"""Rounds of clustering on a level; the words change little after that."""
_FAR = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Vocabulary:
    """A tree of n nodes, breadth first, so that every node's children lie side by side; node 0 is the root.

    ``parent`` (n,) int64, -1 for the root; ``centroid`` (n, W), descriptors of either kind (the root's is zero);
    ``idf`` (n,) float64, the weight of each leaf (0 elsewhere). The leaves are the words, numbered in the order of
    their nodes.
    """

    parent: Ints
    centroid: Descriptors
    idf: Float
    branching: int
    depth: int
    _children: Ints = field(init=False, repr=False)
    _word: Ints = field(init=False, repr=False)

    def __post_init__(self) -> None:
        count = np.bincount(self.parent[1:], minlength=len(self.parent))
        first = 1 + np.cumsum(count) - count
        slot = np.arange(self.branching)
        children = np.where(slot < count[:, None], first[:, None] + slot, -1)
        object.__setattr__(self, "_children", children)
        word = np.where(count == 0, np.cumsum(count == 0) - 1, -1)
        object.__setattr__(self, "_word", word)

    @property
    def is_leaf(self) -> Mask:
        """Which nodes (n,) are words."""
        return self._word >= 0

    @property
    def word_idf(self) -> Float:
        """Weight (W,) of each word."""
        return self.idf[self.is_leaf]

    def __len__(self) -> int:
        """Number of words W."""
        return int(self.is_leaf.sum())

    def words(self, descriptors: Descriptors) -> Ints:
        """Word (N,) of each descriptor (N, W): down the tree, at every node to the nearest child (the first of equals).

        Source: Nister and Stewenius, "Scalable recognition with a vocabulary tree", CVPR 2006.
        """
        node = np.zeros(len(descriptors), dtype=np.int64)
        going = np.flatnonzero(~self.is_leaf[node])
        while len(going):
            children = self._children[node[going]]
            distance = metric_of(descriptors).rank(descriptors[going, None], self.centroid[children])
            distance[children < 0] = _FAR
            node[going] = children[np.arange(len(going)), distance.argmin(axis=1)]
            going = going[~self.is_leaf[node[going]]]
        return self._word[node]

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """The tree as arrays, for ``of_arrays``."""
        shape = np.array([self.branching, self.depth])
        return {"parent": self.parent, "centroid": self.centroid, "idf": self.idf, "shape": shape}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Vocabulary:
        """What ``arrays`` gave; raises ``ValueError`` for what is no tree."""
        branching, depth = (int(number) for number in arrays["shape"])
        return _checked_tree(arrays["parent"], arrays["centroid"], arrays["idf"], branching, depth)

    def save(self, path: Path) -> None:
        """Write the tree as a compressed npz file."""
        with open(path, "wb") as file:  # savez given a name would add .npz to it
            np.savez_compressed(file, allow_pickle=False, format=np.array(_FORMAT), **self.arrays())


def load(path: Path) -> Vocabulary:
    """Read a file of ``Vocabulary.save``; raises ``BenchError`` for anything else."""
    advice = "Write one with `bgs-bench vocabulary`, or leave the vocabulary's path empty to train one on the fly."
    if not path.is_file():
        raise BenchError(f"The vocabulary {path} does not exist. {advice}")
    try:
        with np.load(path, allow_pickle=False) as file:
            if str(file["format"]) != _FORMAT:
                raise BenchError(f"The vocabulary {path} has the format '{file['format']}', not '{_FORMAT}'. {advice}")
            vocabulary = Vocabulary.of_arrays(file)
            if vocabulary.centroid.dtype != np.uint64:
                raise ValueError("its words are no binary descriptors")
    except BenchError:
        raise
    except Exception as error:  # damage leads zip and its decoders to any
        raise BenchError(f"{path} is no vocabulary, or a damaged one ({first_line(error)}). {advice}") from error
    return vocabulary


def _checked_tree(parent: Ints, centroid: Descriptors, idf: Float, branching: int, depth: int) -> Vocabulary:
    """The tree, if the arrays are one; ``ValueError`` says what is wrong."""
    n = len(parent)
    shapes = parent.shape == idf.shape == (n,) == centroid.shape[:1] and are_descriptors(centroid)
    if not shapes or n < 2 or branching < 2:
        raise ValueError(f"arrays of shapes {parent.shape}, {centroid.shape} ({centroid.dtype}), {idf.shape}")
    if parent.dtype != np.int64 or idf.dtype != np.float64:
        raise ValueError(f"arrays of types {parent.dtype}, {idf.dtype}")
    breadth_first = parent[0] == -1 and (np.diff(parent) >= 0).all() and (parent[1:] < np.arange(1, n)).all()
    if not breadth_first or np.bincount(parent[1:]).max() > branching:
        raise ValueError("its nodes are not a tree in breadth-first order")
    if not (np.isfinite(idf).all() and (idf >= 0).all()):
        raise ValueError("it has a weight that is negative or not a number")
    return Vocabulary(parent, centroid, idf, branching, depth)


def train(images: Sequence[Descriptors], branching: int = 10, depth: int = 4, seed: int = 0) -> Vocabulary:
    """Hierarchical clustering, k-majority or k-means, of the descriptors of some images, each (N, W) of one kind.

    At most ``branching ** depth`` words. The weight of a word is log((I + 1) / i) for i of the I images showing it: the
    inverse document frequency of Galvez-Lopez and Tardos (DBoW2, T-RO 2012), made positive for words seen everywhere.
    The same images, numbers and seed give the same tree. Raises ``BenchError`` with fewer than 2 * branching
    descriptors, or numbers that make no tree.
    """
    if branching < 2 or depth < 1:
        raise BenchError(f"A vocabulary needs branching >= 2 and depth >= 1; got {branching} and {depth}.")
    count = sum(map(len, images))
    if count < 2 * branching:
        raise BenchError(
            f"{count} descriptors are too few to train a vocabulary with branching {branching}; "
            f"it takes at least {2 * branching}. Use more or better textured frames."
        )
    descriptors: npt.NDArray[Any] = np.concatenate(images)
    shuffled = descriptors[np.random.default_rng(seed).permutation(count)]
    metric = metric_of(shuffled)
    parent, centroid = [np.array([-1])], [np.zeros_like(shuffled[:1])]
    node = np.zeros(len(shuffled), dtype=np.int64)
    known = 1
    for _ in range(depth):
        cluster, split = _split(shuffled, node, branching)
        present, new = np.unique(cluster[split], return_inverse=True)
        if len(present) == 0:
            break
        parent.append(present // branching)
        centroid.append(metric.middles(shuffled[split], new, len(present)))
        node = np.where(split, 0, -1)
        node[split] = known + new
        # Descriptors of nodes that could not be split are done.
        known += len(present)
        shuffled, node = shuffled[split], node[split]
    tree = Vocabulary(np.concatenate(parent), np.concatenate(centroid), np.zeros(known), branching, depth)
    seen_by = np.zeros(len(tree))
    for image in images:
        seen_by[np.unique(tree.words(image))] += 1
    idf = np.zeros(known)
    idf[tree.is_leaf] = np.log((len(images) + 1) / np.maximum(seen_by, 1))
    return Vocabulary(tree.parent, tree.centroid, idf, branching, depth)


def _split(descriptors: Descriptors, node: Ints, branching: int) -> tuple[Ints, Mask]:
    """Cluster the descriptors of every node into up to ``branching``, all nodes at once.

    Returns the cluster ``node * branching + slot`` of each descriptor, and which descriptors belong to a node that fell
    into at least two. The first descriptors of a node, which come in random order, are its first centroids.
    """
    order = np.argsort(node, kind="stable")
    nodes, start, local = np.unique(node[order], return_index=True, return_inverse=True)
    count = np.diff(start, append=len(node))
    inverse = np.empty_like(local)
    inverse[order] = local
    slot = np.arange(branching)
    centroid = descriptors[order[np.minimum(start[:, None] + slot, len(node) - 1)]]
    empty = slot >= count[:, None]
    cluster, metric = np.full(len(node), -1), metric_of(descriptors)
    for _ in range(_LLOYD_ITERATIONS):
        distance = metric.rank(descriptors[:, None], centroid[inverse])
        distance[empty[inverse]] = _FAR
        before, cluster = cluster, inverse * branching + distance.argmin(axis=1)
        if np.array_equal(before, cluster):
            break
        present, group = np.unique(cluster, return_inverse=True)
        centroid.reshape(-1, centroid.shape[-1])[present] = metric.middles(descriptors, group, len(present))
        empty = np.ones(len(nodes) * branching, dtype=bool)
        empty[present] = False
        empty = empty.reshape(-1, branching)
    split = (~empty).sum(axis=1)[inverse] >= 2
    return nodes[cluster // branching] * branching + cluster % branching, split
