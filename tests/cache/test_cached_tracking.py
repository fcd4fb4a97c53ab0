"""A recorded trajectory is what the tracker would say again: the same bits in a run, and no word of it is lost."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bench.cache.entry import DamagedEntryError
from bench.cache.identity import frame_identity
from bench.cache.recording import Recording
from bench.cache.store import CacheStore
from bench.cache.tracking import CachedTracker
from bench.config import compose_run
from bench.evaluation.run_evaluators import evaluate_run
from bench.slam.run import run_system
from bench.types import Event, StereoFrame, TrackingResult, Trajectory
from plugins.datasets.street import Street, StreetConfig
from plugins.trackers.groundtruth import GroundTruth, GroundTruthConfig
from plugins.trackers.stereo_orb import StereoOrb

SETTINGS = ("dataset.frames=6", "dataset.width=320", "dataset.height=96", "protocol.lpips=false")
MAPPED = "mapper.iterations=2"


@pytest.fixture
def tracked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the frames that the tracker really was shown; it warns of each, and tells of every second."""
    numbers: list[int] = []
    track = StereoOrb.track

    def note(self: StereoOrb, frame: StereoFrame) -> TrackingResult:
        numbers.append(frame.number)
        logging.getLogger("bench.tracking").warning("looked at frame %d", frame.number)
        events = (Event("loop_closed", frame.number, {"to_frame": 0}),) if frame.number % 2 else ()
        return replace(track(self, frame), events=events)

    monkeypatch.setattr(StereoOrb, "track", note)
    return numbers


def run(tmp_path: Path, name: str, *overrides: str) -> Path:
    options = ["cache.all=true", f"cache.folder={tmp_path / 'cache'}", f"output={tmp_path / name}"]
    return run_system(compose_run([*SETTINGS, *options, *overrides])).path


@pytest.mark.slow
def test_a_second_run_repeats_the_first_ones_tracking(tmp_path: Path, tracked: list[int]) -> None:
    """Another loss term and another seed leave tracking as it is; so does the trajectory at each keyframe's time."""
    alone = run(tmp_path, "alone", MAPPED, "cache.all=false", "seed=3", "loss=[rgb,ssim]")
    first = run(tmp_path, "first", MAPPED)
    assert tracked == [*range(6), *range(6)]
    second = run(tmp_path, "second", MAPPED, "seed=3", "loss=[rgb,ssim]")
    assert tracked == [*range(6), *range(6)]
    for name in ("map.ply", "trajectory.csv", "views/left/color/000005.png", "views/right/depth/000003.png"):
        assert (alone / name).read_bytes() == (second / name).read_bytes(), name
    frames = [pd.read_csv(folder / "frames.csv") for folder in (first, second)]
    assert not frames[0]["tracking_cached"].any()
    assert frames[1]["tracking_cached"].all()
    assert frames[1]["stereo_cached"].equals(frames[1]["mapped"])  # SGBM, too
    assert frames[1]["tracking_s"].equals(frames[0]["tracking_s"])
    logs = [(folder / "log.txt").read_text() for folder in (first, second)]
    assert [log.count("looked at frame") for log in logs] == [6, 0]
    assert [log.count("loop_closed (to_frame 0)") for log in logs] == [3, 3]
    assert (first / "events.jsonl").read_bytes() == (alone / "events.jsonl").read_bytes()
    tracked_then = [json.loads(line) for line in (second / "events.jsonl").read_text().splitlines()]
    closed = [event for event in tracked_then if event["kind"] == "loop_closed"]
    assert closed == [{"kind": "loop_closed", "frame": k, "values": {"to_frame": 0}} for k in (1, 3, 5)]
    notes = evaluate_run(second)["notes"]["resources"]
    assert notes.startswith("stereo or sky of 6 frames and tracking of 6 frames came from the cache")


@pytest.mark.slow
@pytest.mark.parametrize("override", ["tracker.keypoints=700", "dataset.seed=5", "dataset.frames=5"])
def test_another_tracker_or_street_is_tracked(tmp_path: Path, tracked: list[int], override: str) -> None:
    run(tmp_path, "one", "mapper=none")
    run(tmp_path, "other", "mapper=none", override)
    assert len(tracked) == 6 + (5 if "frames" in override else 6)


@pytest.mark.slow
def test_frames_that_changed_on_disk_are_tracked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tracked: list[int]
) -> None:
    """The settings are the same, a later picture is not: the tracker is shown all frames, in order."""
    run(tmp_path, "one", "mapper=none")
    tracked.clear()
    frame = Street.frame

    def darker(self: Street, position: int) -> StereoFrame:
        found = frame(self, position)
        return replace(found, left=found.left // 2, right=found.right // 2) if position >= 3 else found

    monkeypatch.setattr(Street, "frame", darker)
    other = run(tmp_path, "other", "mapper=none")
    assert tracked == [0, 1, 2, 3, 4, 5]
    alone = run(tmp_path, "alone", "mapper=none", "cache.all=false")
    assert (other / "trajectory.csv").read_bytes() == (alone / "trajectory.csv").read_bytes()
    assert "frame 3 is not the one that was recorded" in (other / "log.txt").read_text()


@pytest.mark.slow
def test_a_damaged_recording_is_made_again(tmp_path: Path, tracked: list[int]) -> None:
    run(tmp_path, "one", "mapper=none")
    (entry,) = (tmp_path / "cache" / "tracker").rglob("*.entry")
    entry.write_bytes(entry.read_bytes()[:500])
    run(tmp_path, "two", "mapper=none")
    run(tmp_path, "three", "mapper=none")
    assert len(tracked) == 12


def test_a_run_that_stops_early_leaves_no_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.slam.run._Run._take", lambda *nothing: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run(tmp_path, "one", "pipeline=sequential")
    assert not list((tmp_path / "cache").rglob("tracker/*/*/*.entry"))


@pytest.mark.slow
def test_what_finish_corrects_is_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracker that moves its third pose by a metre at the very end."""
    finished: list[bool] = []
    trajectory = StereoOrb.trajectory

    def finish(self: StereoOrb) -> None:
        finished.append(True)

    def corrected(self: StereoOrb) -> Trajectory:
        known = trajectory(self)
        if finished:
            known.T_world_cam[2, 0, 3] += 1.0
        return known

    monkeypatch.setattr(StereoOrb, "finish", finish)
    monkeypatch.setattr(StereoOrb, "trajectory", corrected)
    first = run(tmp_path, "first", "mapper=none")
    second = run(tmp_path, "second", "mapper=none", "seed=3")
    assert len(finished) == 1
    assert (first / "trajectory.csv").read_bytes() == (second / "trajectory.csv").read_bytes()
    moved = pd.read_csv(second / "trajectory.csv").iloc[:, 2:]
    assert abs(moved.to_numpy()[2] - moved.to_numpy()[1]).max() > 0.9


@pytest.mark.parametrize("before", ["recorded", "not recorded"])
@pytest.mark.parametrize("after", ["recorded", "not recorded"])
def test_a_cached_tracker_goes_on_from_its_state(tmp_path: Path, before: str, after: str) -> None:
    """Whether the frames were recorded when the run was broken, and when it goes on."""
    street = Street(StreetConfig(frames=6, width=64, height=32))

    def started(folder: str) -> CachedTracker:
        config = GroundTruthConfig(name="groundtruth", noise_m=0.1)
        tracker = CachedTracker(GroundTruth(config), config, {}, CacheStore(tmp_path / folder, 1e9))
        tracker.start(street)
        return tracker

    def track(tracker: CachedTracker, positions: range) -> None:
        for position in positions:
            tracker.track(street.frame(position))

    whole = started("recorded")
    track(whole, range(6))
    whole.finish()
    broken = started(before)
    track(broken, range(3))
    again = started(after)
    again.restore(broken.state())  # type: ignore[arg-type]
    np.testing.assert_array_equal(again.trajectory().T_world_cam, broken.trajectory().T_world_cam)
    track(again, range(3, 6))
    again.finish()
    np.testing.assert_array_equal(again.trajectory().T_world_cam, whole.trajectory().T_world_cam)


def test_by_default_nothing_quick_is_kept(tmp_path: Path) -> None:
    run(tmp_path, "one", "mapper=none", "cache.all=false")
    assert not (tmp_path / "cache").exists()


def pose(x: float) -> Any:
    T = np.eye(4)
    T[0, 3] = x
    return T


def test_a_recording_by_hand() -> None:
    """Frame 1 is lost, frame 2 corrects frame 0: only frames 0 and 2 of the trajectory have to be kept then."""
    recording = Recording()
    happened = Event("seen_é", 1, {"m": 0.1 + 0.2, "who": ["a", 3]})
    trajectories = [
        Trajectory(np.array([pose(0.1)]), np.array([0]), np.array([0.0])),
        Trajectory(np.array([pose(0.1)]), np.array([0]), np.array([0.0])),
        Trajectory(np.array([pose(0.2), pose(2.0)]), np.array([0, 2]), np.array([0.0, 0.2])),
    ]
    results = [
        TrackingResult(pose(0.1), "ok", 50, 0.25, np.array([3, 9])),
        TrackingResult(None, "lost", 2, float("nan"), None, (happened,)),
        TrackingResult(pose(2.0), "weak", 7, 1.5, np.zeros(0, np.int64)),
    ]
    for k, (result, after) in enumerate(zip(results, trajectories, strict=True)):
        assert recording.add(bytes([k]) * 32, result, 0.5 + k, after)
    again = Recording.decode(recording.encode())
    assert [frame.rows.tolist() for frame in again.frames] == [[0], [], [0, 1]]
    assert [frame.poses[:, 0, 3].tolist() for frame in again.frames] == [[0.1], [], [0.2, 2.0]]
    assert [frame.digest[0] for frame in again.frames] == [0, 1, 2]
    assert [frame.seconds for frame in again.frames] == [0.5, 1.5, 2.5]
    assert [frame.result.events for frame in again.frames] == [(), (happened,), ()]
    assert again.numbers.tolist() == [0, 2]
    assert again.timestamps.tolist() == [0.0, 0.2]
    for one, other in zip(results, (frame.result for frame in again.frames), strict=True):
        assert (one.state, one.inliers) == (other.state, other.inliers)
        np.testing.assert_array_equal(one.reprojection_px, other.reprojection_px)
        for name in ("T_world_cam", "landmarks"):
            first, second = getattr(one, name), getattr(other, name)
            assert (first is None) == (second is None), name
            if first is not None:
                np.testing.assert_array_equal(first, second)


def test_a_tracker_that_drops_frames_is_not_recorded() -> None:
    recording = Recording()
    result = TrackingResult(pose(0), "ok")
    assert recording.add(bytes(32), result, 0.0, Trajectory(pose(0)[None], np.array([0]), np.array([0.0])))
    assert not recording.add(bytes(32), result, 0.0, Trajectory(pose(1)[None], np.array([1]), np.array([0.1])))


def test_bytes_of_something_else_are_refused() -> None:
    with pytest.raises(DamagedEntryError):
        Recording.decode(json.dumps({"a": 1}).encode())


def test_every_part_of_a_frame_counts() -> None:
    image = np.zeros((4, 6, 3), np.uint8)
    frame = StereoFrame(3, 0.3, image, image)
    brighter = image.copy()
    brighter[3, 5, 2] = 1
    others = [replace(frame, number=4), replace(frame, timestamp=0.4)]
    others += [replace(frame, left=brighter), replace(frame, right=brighter)]
    assert len({frame_identity(each, with_time=True) for each in (frame, *others)}) == 5
    assert frame_identity(replace(frame, left=image.copy()), with_time=True) == frame_identity(frame, with_time=True)
