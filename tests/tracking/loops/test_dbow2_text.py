"""The DBoW2 text file against a reader written from the format's description, with Python's own integers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.tracking.loops.dbow2_text import dbow2_text, write_dbow2
from bench.tracking.loops.vocabulary import Vocabulary, train


def read_as_dbow2_does(text: str) -> tuple[list[int], dict[int, tuple[int, bool, int, float]]]:
    """Header, and for each node from 1 on: parent, leaf or not, the descriptor as one integer, weight."""
    header, *lines = text.split("\n")
    nodes = {}
    for number, line in enumerate(lines, start=1):
        words = line.split(" ")
        assert len(words) == 35
        assert words[1] in ("0", "1")
        descriptor = int.from_bytes(bytes(map(int, words[2:34])), "big")
        nodes[number] = (int(words[0]), words[1] == "1", descriptor, float(words[34]))
    return [int(word) for word in header.split(" ")], nodes


def leaf_of(nodes: dict[int, tuple[int, bool, int, float]], descriptor: bytes) -> int:
    """Down the tree, at every node to the child with the fewest other bits, the first of equals."""
    wanted, node = int.from_bytes(descriptor, "big"), 0
    while node == 0 or not nodes[node][1]:
        children = [number for number, (parent, *_) in nodes.items() if parent == node]
        node = min(children, key=lambda number: (nodes[number][2] ^ wanted).bit_count())
    return node


@pytest.fixture(scope="module")
def vocabulary() -> Vocabulary:
    rng = np.random.default_rng(5)
    images = [rng.integers(0, 2**64, (60, 4), dtype=np.uint64) for _ in range(3)]
    return train(images, branching=3, depth=3)


def test_a_reader_finds_the_same_words_and_weights(vocabulary: Vocabulary) -> None:
    header, nodes = read_as_dbow2_does(dbow2_text(vocabulary))
    assert header == [3, 3, 0, 0]
    assert sum(leaf for _, leaf, _, _ in nodes.values()) == len(vocabulary)
    leaves = [number for number in sorted(nodes) if nodes[number][1]]
    seen = np.random.default_rng(6).integers(0, 2**64, (40, 4), dtype=np.uint64)
    found = [leaf_of(nodes, descriptor.tobytes()) for descriptor in seen]
    np.testing.assert_array_equal([leaves.index(leaf) for leaf in found], vocabulary.words(seen))
    np.testing.assert_allclose([nodes[n][3] for n in leaves], vocabulary.word_idf, rtol=1e-8)
    # A parent comes before its children: readers append each node to one that they know.
    assert all(parent < number for number, (parent, *_) in nodes.items())


def test_a_tree_by_hand() -> None:
    centroid = np.zeros((3, 4), np.uint64)
    centroid[2] = np.array([1] + [0] * 30 + [255], np.uint8).view(np.uint64)
    tree = Vocabulary(np.array([-1, 0, 0]), centroid, np.array([0.0, 0.5, 2.25]), branching=2, depth=1)
    zeros = " ".join(["0"] * 30)
    assert dbow2_text(tree) == f"2 1 0 0\n0 1 0 0 {zeros} 0.5\n0 1 1 {zeros} 255 2.25"


def test_the_file_does_not_end_in_a_line_end(tmp_path: Path, vocabulary: Vocabulary) -> None:
    write_dbow2(tmp_path / "v.txt", vocabulary)
    assert (tmp_path / "v.txt").read_text() == dbow2_text(vocabulary)
    assert not (tmp_path / "v.txt").read_bytes().endswith(b"\n")
