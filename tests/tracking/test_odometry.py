"""The odometry's hooks for loop closing, and relocalisation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.errors import BenchError
from bench.geometry import se3
from bench.tracking.local_map import View


def centres(results: list[Any]) -> np.ndarray:
    return np.array([r.T_world_cam[:3, 3] for r in results])


@pytest.mark.slow
def test_street_is_tracked_to_a_centimetre_a_frame(drive: Any, odometry: Any) -> None:
    tracker = odometry()
    results = [tracker.track(*pair, 0.1 * i) for i, pair in enumerate(drive.pairs)]
    assert [r.state for r in results] == ["ok"] * 24
    assert all(r.inliers >= 25 and 0 < r.rms_px < 5 for r in results[1:])
    steps = np.linalg.norm(np.diff(centres(results) - drive.poses[:, :3, 3], axis=0), axis=1)
    assert steps.mean() < 0.015


def test_second_frame_far_away_is_not_mistaken_for_the_next_house(drive: Any, odometry: Any) -> None:
    """Without a known velocity, a pose that sees the wrong one of two like windows finds dozens of inliers."""
    tracker = odometry()
    results = [tracker.track(*drive.pairs[i], 0.1 * i) for i in (0, 3, 6, 9)]
    np.testing.assert_allclose(centres(results), drive.poses[[0, 3, 6, 9], :3, 3], atol=0.15)


def test_new_keyframes_are_shown_and_counted(drive: Any, odometry: Any) -> None:
    tracker = odometry()
    assert tracker.keyframe_poses().shape == (0, 4, 4)
    shown = []
    for i in (0, 1, 1, 2):
        result = tracker.track(*drive.pairs[i], 0.1 * len(shown))
        shown.append(tracker.new_keyframe)
        if shown[-1] is not None:
            np.testing.assert_allclose(tracker.keyframe_poses()[-1], result.T_world_cam, atol=1e-9)
    assert [None if k is None else k.index for k in shown] == [0, 1, None, 2]
    assert [k.begins_map for k in shown if k is not None] == [True, False, False]
    assert len(tracker.keyframe_poses()) == 3


def test_correction_moves_everything_and_tracking_continues(drive: Any, odometry: Any) -> None:
    """All keyframes moved by one rigid motion: what follows must be the uncorrected track, moved by it."""
    motion = se3.exp(np.array([3.0, -1.0, 7.0, 0.1, -0.4, 0.05]))
    plain, corrected = odometry(), odometry()
    for i in range(8):
        for tracker in (plain, corrected):
            tracker.track(*drive.pairs[i], 0.1 * i)
    corrected.correct(motion @ corrected.keyframe_poses())
    for i in range(8, 12):
        a, b = (tracker.track(*drive.pairs[i], 0.1 * i) for tracker in (plain, corrected))
        assert b.state == "ok"
        np.testing.assert_allclose(b.T_world_cam, motion @ a.T_world_cam, atol=0.02)


def test_points_move_with_the_keyframe_that_saw_them_last(drive: Any, odometry: Any) -> None:
    tracker = odometry()
    for i in range(6):
        tracker.track(*drive.pairs[i], 0.1 * i)
    poses = tracker.keyframe_poses()
    shift = np.arange(len(poses), dtype=float)
    moved = poses.copy()
    moved[:, 0, 3] += shift
    seen, before = tracker._map.points.seen, tracker._map.points.position.copy()
    tracker.correct(moved)
    np.testing.assert_allclose(tracker._map.points.position[:, 0] - before[:, 0], shift[seen], atol=1e-9)
    np.testing.assert_allclose(tracker._map.points.position[:, 1:], before[:, 1:], atol=1e-9)
    np.testing.assert_array_equal(tracker.keyframe_poses(), moved)


@pytest.mark.parametrize("wrong", ["one short", "not finite"])
def test_wrong_corrections_are_refused(drive: Any, odometry: Any, wrong: str) -> None:
    tracker = odometry()
    for i in range(3):
        tracker.track(*drive.pairs[i], 0.1 * i)
    poses = tracker.keyframe_poses()
    poses = poses[1:] if wrong == "one short" else poses * np.nan
    with pytest.raises(BenchError, match=r"Corrected keyframe poses have shape .* expected \(3, 4, 4\), all finite"):
        tracker.correct(poses)


def test_a_recognised_place_is_where_the_new_map_begins(drive: Any, odometry: Any) -> None:
    """A tunnel of black frames, then a place seen before: the relocaliser says where, tracking goes on from there."""
    asked = []

    def relocalise(view: View) -> tuple[int, np.ndarray] | None:
        asked.append(len(view.features))
        if len(view.features) < 100:
            return None
        return 2, np.linalg.inv(drive.poses[2]) @ drive.poses[4]

    tracker = odometry(relocaliser=relocalise)
    for i in range(8):
        tracker.track(*drive.pairs[i], 0.1 * i)
    assert not asked
    black = np.zeros_like(drive.pairs[0][0])
    dark = [tracker.track(black, black, 0.8 + 0.1 * i) for i in range(12)]
    assert {r.state for r in dark} == {"lost"}
    back = [tracker.track(*drive.pairs[i], 1.6 + 0.1 * i) for i in (4, 5, 6)]
    assert [r.state for r in back] == ["weak", "ok", "ok"]
    assert [r.recognised for r in [*dark, *back]] == [None] * 12 + [2, None, None]
    assert asked[-1] >= 100
    np.testing.assert_allclose(centres(back), drive.poses[4:7, :3, 3], atol=0.1)
    assert tracker.new_keyframe.index == len(tracker.keyframe_poses()) - 1
