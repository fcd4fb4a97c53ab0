"""Two views of the same place, of different places, and of places that share one thing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench.geometry import se3
from bench.tracking.loops.places import Place
from bench.tracking.loops.verification import close, verify


@pytest.fixture(scope="module")
def road(make_road: Any) -> Any:
    return make_road()


def place(road: Any, s: float, seed: int) -> Place:
    return Place.of(road.view(s, np.random.default_rng(seed)), 0, road.camera.fx / 100, 1.2)


def test_the_pose_between_two_views_of_a_place(road: Any) -> None:
    for s_old, s_new in ((50.0, 50.3), (50.0, 53.0), (53.0, 50.0)):
        verified = verify(road.camera, place(road, s_old, 1), place(road, s_new, 2), 30)
        assert verified is not None
        truth = se3.inverse(road.pose(s_old)) @ road.pose(s_new)
        assert close(se3.inverse(truth) @ verified.T_old_new, 0.1, 0.2)
        assert verified.inliers > 60


def test_covariance_covers_the_true_error(road: Any) -> None:
    chi2 = []
    truth = se3.inverse(road.pose(50.0)) @ road.pose(51.5)
    for seed in range(30):
        verified = verify(road.camera, place(road, 50.0, seed), place(road, 51.5, 100 + seed), 30)
        assert verified is not None
        error = se3.log(se3.inverse(verified.T_old_new) @ truth)
        chi2.append(error @ np.linalg.solve(verified.covariance, error))
    # 6 on average for an exact covariance; it is meant to be on the safe side, but not absurdly so.
    assert 0.05 < np.mean(chi2) < 6.0
    assert np.max(chi2) < 16.8  # the pose graph's gate for a loop


def test_different_places_share_no_pose(road: Any) -> None:
    # 15 m is half a period of the repeated wall.
    assert verify(road.camera, place(road, 20.0, 1), place(road, 95.0, 2), 30) is None


def test_a_repeated_facade_alone_passes_here_so_that_the_rest_has_something_to_catch(road: Any) -> None:
    verified = verify(road.camera, place(road, 20.0, 1), place(road, 110.0, 2), 20)
    assert verified is not None
    assert np.linalg.norm(verified.T_old_new[:3, 3]) < 1.0  # in truth the places lie 90 m of road apart


def test_inliers_in_one_corner_are_no_place(road: Any) -> None:
    old, new = place(road, 50.0, 1), place(road, 50.5, 2)
    corner = np.flatnonzero((new.xy[:, 0] < 200) & (new.xy[:, 1] < 128))
    arrays = {name: getattr(new, name)[corner] for name in ("xy", "octave", "disparity", "descriptors")}
    assert verify(road.camera, old, replace(new, **arrays), 15) is None
    assert verify(road.camera, old, new, 15) is not None


def test_too_few_keypoints(road: Any) -> None:
    full = place(road, 50.0, 1)
    empty = replace(full, **{name: getattr(full, name)[:0] for name in ("xy", "octave", "disparity", "descriptors")})
    assert verify(road.camera, full, empty, 30) is None
    assert verify(road.camera, empty, full, 30) is None
