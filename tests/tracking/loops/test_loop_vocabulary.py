"""The vocabulary tree against a walk down the tree one descriptor at a time, and its file against damaged ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.errors import BenchError
from bench.tracking.loops.vocabulary import Vocabulary, load, train


def images(seed: int, count: int = 8, size: int = 400) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 2**64, (size, 4), dtype=np.uint64) for _ in range(count)]


def bits_apart(a: np.ndarray, b: np.ndarray) -> int:
    return sum(bin(int(x) ^ int(y)).count("1") for x, y in zip(a, b, strict=True))


def walked_word(tree: Vocabulary, descriptor: np.ndarray) -> int:
    """The word of one descriptor, found node by node in plain Python."""
    node = 0
    while True:
        children = [n for n in range(len(tree.parent)) if tree.parent[n] == node]
        if not children:
            leaves = sorted(set(range(len(tree.parent))) - {int(p) for p in tree.parent})
            return leaves.index(node)
        distances = [bits_apart(tree.centroid[n], descriptor) for n in children]
        node = children[distances.index(min(distances))]


@pytest.fixture(scope="module")
def tree() -> Vocabulary:
    return train(images(0), branching=4, depth=3, seed=0)


def test_words_are_those_of_a_walk_down_the_tree(tree: Vocabulary) -> None:
    others = np.concatenate([images(1, 1, 60)[0], images(0)[0][:20]])
    assert tree.words(others).tolist() == [walked_word(tree, d) for d in others]


def test_a_full_tree_has_branching_to_the_depth_words(tree: Vocabulary) -> None:
    assert len(tree) == 4**3
    assert len(tree.parent) == 1 + 4 + 16 + 64
    assert tree.words(np.empty((0, 4), np.uint64)).tolist() == []


def test_well_separated_clusters_become_words_with_their_exact_centres(flip_bits: Any) -> None:
    rng = np.random.default_rng(3)
    centres = rng.integers(0, 2**64, (3, 4), dtype=np.uint64)
    label = rng.integers(0, 3, 900)
    noisy = flip_bits(centres[label], 0.1, rng)
    tree = train([noisy], branching=3, depth=1, seed=1)
    assert {tuple(c) for c in tree.centroid[1:]} == {tuple(c) for c in centres}
    assert len({(int(w), int(c)) for w, c in zip(tree.words(noisy), label, strict=True)}) == 3


def test_idf_is_the_logarithm_of_images_by_images_with_the_word() -> None:
    a, b = np.zeros((1, 4), np.uint64), np.full((1, 4), 2**64 - 1, np.uint64)
    tree = train([np.tile(a, (9, 1)), np.tile(a, (9, 1)), np.concatenate([a, b])], branching=2, depth=1)
    weight = dict(zip(("a", "b"), tree.word_idf[tree.words(np.concatenate([a, b]))], strict=True))
    assert weight["a"] == pytest.approx(np.log(4 / 3))
    assert weight["b"] == pytest.approx(np.log(4 / 1))


def test_the_same_seed_gives_the_same_tree_and_another_seed_another() -> None:
    first, again, other = (train(images(5), 5, 2, seed) for seed in (0, 0, 1))
    assert np.array_equal(first.centroid, again.centroid)
    assert not np.array_equal(first.centroid, other.centroid)


def test_equal_descriptors_end_in_one_word() -> None:
    same = np.full((50, 4), 7, np.uint64)
    tree = train([same, images(6, 1, 5)[0]], branching=3, depth=4)
    assert len(set(tree.words(same).tolist())) == 1


def test_too_few_descriptors_and_senseless_numbers() -> None:
    with pytest.raises(BenchError, match=r"7 descriptors are too few .* at least 20"):
        train([np.zeros((7, 4), np.uint64)])
    with pytest.raises(BenchError, match="branching >= 2 and depth >= 1; got 1 and 3"):
        train(images(0), branching=1, depth=3)


def test_file_round_trip(tree: Vocabulary, tmp_path: Path) -> None:
    tree.save(tmp_path / "words.voc")
    read = load(tmp_path / "words.voc")
    assert np.array_equal(read.words(images(2)[0]), tree.words(images(2)[0]))
    assert np.array_equal(read.idf, tree.idf)
    assert (read.branching, read.depth) == (4, 3)


@pytest.mark.parametrize("damage", ["missing", "text", "cut", "other", "format", "cycle", "weight", "pickle"])
def test_wrong_files_are_refused_in_one_sentence(tree: Vocabulary, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "bad.npz"
    tree.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    if damage == "missing":
        path.unlink()
    elif damage == "text":
        path.write_text("10 6 0 0\n")
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:-400])
    elif damage == "other":
        np.savez(path, poses=np.eye(4))
    else:
        arrays["format"] = np.array("something else") if damage == "format" else arrays["format"]
        arrays["parent"][5] = 70 if damage == "cycle" else arrays["parent"][5]
        arrays["idf"][60] = np.nan if damage == "weight" else arrays["idf"][60]
        if damage == "pickle":
            arrays["parent"] = np.array([{}], dtype=object)
        np.savez(path, **arrays)
    with pytest.raises(BenchError, match=r"bad\.npz") as error:
        load(path)
    assert "bgs-bench vocabulary" in str(error.value)
    assert "\n" not in str(error.value)
