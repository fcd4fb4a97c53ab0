"""Poses of frames that hang on keyframes, and rows that are kept in groups."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.geometry import se3
from bench.io.array_store import ArrayStore
from bench.tracking.frame_track import FrameTrack
from bench.tracking.growing import Archive, Growing
from bench.tracking.odometry import FramePose

NONE = np.empty(0, np.int64)


def test_poses_follow_their_keyframes_whatever_moved_since() -> None:
    """Against the product of each frame's pose with its keyframe's, for every frame."""
    rng = np.random.default_rng(0)
    track, keyframes, frames = FrameTrack(), se3.exp(rng.normal(0, 1, (30, 6))), []
    for number in range(60):
        relative = se3.exp(rng.normal(0, 1, 6))
        lost = number % 7 == 3
        track.add(number, 0.1 * number, FramePose("ok", None if lost else np.eye(4), number // 2, relative, 9, 1, NONE))
        frames += [] if lost else [(number, number // 2, relative)]
        moved = int(rng.integers(0, 31)) if number % 3 else 0
        keyframes[moved:] = se3.exp(rng.normal(0, 1, (30 - moved, 6)))
        known = track.trajectory(keyframes, moved)
        assert known.numbers.tolist() == [frame for frame, _, _ in frames]
        np.testing.assert_array_equal(known.T_world_cam, [keyframes[k] @ T for _, k, T in frames])


def test_what_was_given_stays_when_poses_move() -> None:
    track, keyframes = FrameTrack(), np.tile(np.eye(4), (2, 1, 1))
    track.add(0, 0.0, FramePose("ok", np.eye(4), 0, np.eye(4), 9, 1.0, NONE))
    before = track.trajectory(keyframes, 0)
    keyframes[0, 0, 3] = 5.0
    assert track.trajectory(keyframes, 0).T_world_cam[0, 0, 3] == 5.0
    assert before.T_world_cam[0, 0, 3] == 0.0


def test_rows_of_an_array_that_grows() -> None:
    grown = Growing(np.empty((0, 2), np.int64))
    for k in range(200):
        grown.append((k, -k))
    np.testing.assert_array_equal(grown.rows, np.column_stack([np.arange(200), -np.arange(200)]))


@pytest.mark.parametrize("kept_in", ["store", "memory", "memory, since the disk is full"])
def test_settled_rows_are_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept_in: str) -> None:
    monkeypatch.setattr("bench.tracking.growing._GROUP", 4)
    store, archive = ArrayStore(tmp_path), Archive()
    if kept_in != "memory":
        archive.use_store(store)
    if "full" in kept_in:
        monkeypatch.setattr(store, "put", lambda *nothing: (_ for _ in ()).throw(BenchError("No space left")))
    rows = np.arange(11)
    archive.rows("steps", {"x": rows}, 6)
    state = archive.rows("steps", {"x": rows}, 9)
    assert store.names() == (["steps-0", "steps-1"] if kept_in == "store" else [])
    assert state["rest"]["x"].tolist() == [8, 9, 10]
    again = Archive()
    again.use_store(store)
    again.restore(archive.state())
    np.testing.assert_array_equal(again.rows_of("steps", state)["x"], rows)
