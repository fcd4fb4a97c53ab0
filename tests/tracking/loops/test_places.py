"""Similarity of places: hand-worked numbers, and the inverted index against the formula taken literally."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.tracking.growing import Archive
from bench.tracking.loops.places import Place, PlaceIndex, WordVector, best_places, similarity, word_vector
from bench.tracking.loops.vocabulary import Vocabulary


def one_level(idf: list[float]) -> tuple[Vocabulary, np.ndarray]:
    """A vocabulary whose words are the given weights, and a descriptor of each word."""
    centroid = np.random.default_rng(0).integers(0, 2**64, (1 + len(idf), 4), dtype=np.uint64)
    parent = np.array([-1] + [0] * len(idf))
    return Vocabulary(parent, centroid, np.array([0.0, *idf]), len(idf), 1), centroid[1:]


def test_tf_idf_and_similarity_of_a_toy_worked_by_hand() -> None:
    vocabulary, word = one_level([1.0, 2.0, 4.0])
    a = word_vector(vocabulary, word[[0, 0, 1]])  # weights 2, 2, 0 -> 1/2, 1/2
    b = word_vector(vocabulary, word[[1, 2, 0, 0]])  # weights 2, 2, 4 -> 1/4, 1/4, 1/2
    assert a.words.tolist() == [0, 1]
    assert a.values.tolist() == [0.5, 0.5]
    assert b.values.tolist() == [0.25, 0.25, 0.5]
    # 1 - (|1/2 - 1/4| + |1/2 - 1/4| + |0 - 1/2|) / 2
    assert similarity(a, b) == 0.5
    assert similarity(a, a) == 1.0
    assert similarity(a, word_vector(vocabulary, word[[2]])) == 0.0


def test_an_image_without_keypoints_is_like_nothing() -> None:
    vocabulary, word = one_level([1.0, 2.0])
    nothing = word_vector(vocabulary, np.empty((0, 4), np.uint64))
    index = PlaceIndex(2, Archive())
    index.add(nothing)
    assert index.scores(word_vector(vocabulary, word)).tolist() == [0.0]
    assert index.scores(nothing).tolist() == [0.0]


def test_index_scores_are_the_l1_formula_across_blocks() -> None:
    rng = np.random.default_rng(1)
    dense = rng.random((300, 50)) * (rng.random((300, 50)) < 0.3)
    dense = (dense / dense.sum(axis=1, keepdims=True)).astype(np.float32)
    vectors = [WordVector(np.flatnonzero(row), row[row > 0]) for row in dense]
    index = PlaceIndex(50, Archive())
    for n, vector in enumerate(vectors[:299]):
        if n in (0, 1, 127, 128, 129, 298):
            literal = 1 - 0.5 * np.abs(dense[:n] - dense[299]).sum(axis=1)
            assert np.allclose(index.scores(vectors[299]), literal, atol=1e-6)
        index.add(vector)
    assert len(index) == 299


def test_best_places_groups_neighbours() -> None:
    #                    0    1    2    3    4    5    6    7    8    9
    scores = np.array([0.1, 0.5, 0.4, 0.0, 0.0, 0.0, 0.8, 0.0, 0.3, 0.3])
    everywhere = np.ones(10, dtype=bool)
    # Groups {1, 2} with 0.9 and {6, 8, 9} with 1.4; 0 is below the least score.
    assert best_places(scores, everywhere, least=0.2, groups=2).tolist() == [6, 1]
    assert best_places(scores, everywhere, least=0.2, groups=1).tolist() == [6]
    assert best_places(scores, np.arange(10) < 6, least=0.2, groups=2).tolist() == [1]
    assert best_places(scores, everywhere, least=0.9, groups=2).tolist() == []


def test_a_place_keeps_near_keypoints_and_their_points(make_road: Any, road_camera: Any) -> None:
    road = make_road()
    view = road.view(20.0, np.random.default_rng(2))
    place = Place.of(view, 3, road_camera.fx * road_camera.baseline / 20.0, 1.2)
    assert 50 < len(place) < np.isfinite(view.disparity).sum()
    everything = np.arange(len(place))
    points = place.points(road_camera, everything)
    assert points[:, 2].max() == pytest.approx(20.0, abs=0.5)
    # Projected again, the points are the keypoints.
    uv = points[:, :2] / points[:, 2:] * road_camera.fx + (road_camera.cx, road_camera.cy)
    assert np.abs(uv - place.xy).max() < 1e-3
    # Beyond 35 baselines a disparity is no measurement.
    far = points[:, 2] > 35.0 * road_camera.baseline + 0.01
    assert np.array_equal(np.isnan(place.observations(everything).disparity), far)
