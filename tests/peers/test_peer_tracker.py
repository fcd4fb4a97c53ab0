"""Frames and poses when a peer does its work, and when it crashes, hangs, begins new maps or talks nonsense."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.peers.tracker import PeerLimits, PeerTracker
from bench.types import StereoCamera, StereoFrame, TrackingResult

FAKE = [sys.executable, "-P", str(Path(__file__).parent / "fake_peer.py")]
GREY = np.full((30, 50, 3), 128, np.uint8)


class Frames(Dataset):
    """Grey frames numbered 10, 11, 12 ... at 10 Hz."""

    def __init__(self, count: int) -> None:
        self.label = "grey"
        self.camera = StereoCamera(50, 30, 40.0, 40.0, 24.5, 14.5, (0.5, 0.0, 0.0))
        self.numbers = tuple(range(10, 10 + count))

    def frame(self, position: int) -> StereoFrame:
        return StereoFrame(self.numbers[position], 1.0 + 0.1 * position, GREY, GREY)


class FakeTracker(PeerTracker):
    """The bench's side of the fake peer."""

    def __init__(self, restarts: int = 3, timeout_s: float = 20.0, **settings: Any) -> None:
        super().__init__("fake", FAKE, PeerLimits(20.0, timeout_s, restarts))
        self.settings = settings

    def peer_settings(self, dataset: Dataset) -> dict[str, Any]:
        return self.settings


def drive(tracker: FakeTracker, frames: int) -> list[TrackingResult]:
    """Track frames; the peer's process is checked to be there for the trajectory, and gone after the end."""
    dataset = Frames(frames)
    tracker.start(dataset)
    results = [tracker.track(dataset.frame(position)) for position in range(frames)]
    tracker.trajectory()
    tracker.finish()
    assert tracker._peer is None
    return results


def test_a_peer_needs_right_images() -> None:
    frames = Frames(2)
    frames.has_right = False
    with pytest.raises(BenchError, match=r"tracker=fake needs right images, and grey has none\. Choose tracker="):
        FakeTracker().start(frames)
    tracker = FakeTracker()
    tracker.start(Frames(2))
    with pytest.raises(BenchError, match="tracker=fake needs a right image, and frame 10 has none"):
        tracker.track(StereoFrame(10, 1.0, GREY))
    tracker.finish()


def states(results: list[TrackingResult]) -> str:
    return " ".join(result.state for result in results)


def z(results: list[TrackingResult]) -> list[float | None]:
    """How far each pose is along the drive, to a nanometre."""
    return [None if one.T_world_cam is None else round(float(one.T_world_cam[2, 3]), 9) for one in results]


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.message for record in caplog.records if record.levelno == logging.WARNING]


def test_poses_pass_through(caplog: pytest.LogCaptureFixture) -> None:
    tracker = FakeTracker(events={"11": "weak"})
    results = drive(tracker, 3)
    assert states(results) == "ok weak ok"
    assert z(results) == [0, 1, 2]
    assert results[0].inliers == 40
    trajectory = tracker.trajectory()
    assert trajectory.numbers.tolist() == [10, 11, 12]
    np.testing.assert_allclose(trajectory.timestamps, [1.0, 1.1, 1.2])
    np.testing.assert_allclose(trajectory.T_world_cam[:, :3, 3], [[0, 0, 0], [0, 0, 1], [0, 0, 2]], atol=1e-12)
    assert warnings(caplog) == []


@pytest.mark.parametrize(
    ("event", "limit_s", "reason"),
    [
        ("segfault", 20.0, "fake was killed by SIGSEGV; its last words: what a peer prints is no answer."),
        ("exit", 20.0, "fake ended with exit code 3; its last words: out of luck."),
        ("hang", 0.5, "fake gave no answer within 0.5 s and was killed."),
        ("raise", 20.0, "fake reports: RuntimeError: frame without a name."),
    ],
)
def test_a_failure_costs_one_frame_and_the_next_map_is_put_at_constant_velocity(
    caplog: pytest.LogCaptureFixture, event: str, limit_s: float, reason: str
) -> None:
    tracker = FakeTracker(timeout_s=limit_s, events={"12": event})
    results = drive(tracker, 5)
    # 1 m per frame: frame 12 would have been at 2 m, so the new map begins at 3 m.
    assert states(results) == "ok ok lost predicted ok"
    assert z(results) == [0, 1, None, 3, 4]
    assert tracker.trajectory().numbers.tolist() == [10, 11, 13, 14]
    assert warnings(caplog) == [
        f"frame 12: {reason} The frame is lost",
        "frame 13: fake is started again; it begins a new map",
        "frame 13: fake began a new map, put at constant velocity",
    ]


def test_after_too_many_failures_all_frames_are_lost(caplog: pytest.LogCaptureFixture) -> None:
    events = dict.fromkeys(map(str, range(12, 20)), "exit")
    results = drive(FakeTracker(restarts=1, events=events), 8)
    assert states(results) == "ok ok lost lost lost lost lost lost"
    (last,) = [text for text in warnings(caplog) if "failure number 2" in text]
    assert last == (
        "frame 13: fake ended with exit code 3; its last words: out of luck. That was failure number 2: "
        "all further frames are lost"
    )
    assert len(warnings(caplog)) == 3


def test_a_peer_that_can_not_start_is_an_error_before_the_run() -> None:
    with pytest.raises(BenchError) as error:
        FakeTracker(start="refuse").start(Frames(2))
    assert str(error.value) == (
        "tracker=fake: its process reports: ValueError: no such vocabulary. Correct the tracker's settings, or use "
        "tracker=stereo_orb."
    )
    with pytest.raises(BenchError, match=r"its process ended with exit code 3; its last words: out of luck\. Correct"):
        FakeTracker(start="exit").start(Frames(2))


def test_poses_that_are_no_poses_are_lost_frames_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    results = drive(FakeTracker(events={"11": "nan", "12": "sheared", "14": "lost"}), 6)
    assert states(results) == "ok lost lost ok lost ok"
    assert z(results) == [0, None, None, 3, None, 5]
    assert warnings(caplog) == ["frame 11: the pose that fake gave is no rigid motion; lost"]


def test_a_new_map_of_the_peer_begins_where_the_camera_must_be(caplog: pytest.LogCaptureFixture) -> None:
    results = drive(FakeTracker(events={"12": "lost", "13": "lost", "14": "new map"}), 6)
    assert states(results) == "ok ok lost lost predicted ok"
    assert z(results) == [0, 1, None, None, 4, 5]
    assert warnings(caplog) == ["frame 14: fake began a new map, put at constant velocity"]


def test_corrections_move_earlier_poses_only_of_the_same_process() -> None:
    tracker = FakeTracker(events={"12": "exit", "15": "correct"}, finish="")
    drive(tracker, 6)
    x = tracker.trajectory().T_world_cam[:, 0, 3]
    # 10 and 11 came from the process that crashed; 15 itself is answered with its pose.
    np.testing.assert_allclose(x, [0, 0, 0.5, 0.5, 0], atol=1e-12)


def test_the_final_poses_are_those_of_the_end() -> None:
    tracker = FakeTracker(finish="correct")
    results = drive(tracker, 4)
    np.testing.assert_allclose([one.T_world_cam[0, 3] for one in results], 0, atol=1e-12)  # type: ignore[index]
    np.testing.assert_allclose(tracker.trajectory().T_world_cam[:, 0, 3], 0.25, atol=1e-12)


def test_a_crash_at_the_end_costs_only_the_corrections(caplog: pytest.LogCaptureFixture) -> None:
    tracker = FakeTracker(finish="segfault")
    drive(tracker, 3)
    np.testing.assert_allclose(tracker.trajectory().T_world_cam[:, 2, 3], [0, 1, 2], atol=1e-12)
    (text,) = warnings(caplog)
    assert text.startswith("at the end, fake was killed by SIGSEGV")
    assert text.endswith("the poses are those that it gave frame by frame")


def test_a_second_sequence_begins_anew() -> None:
    tracker = FakeTracker(restarts=0, events={"12": "exit"})
    assert states(drive(tracker, 4)) == "ok ok lost lost"
    assert states(drive(tracker, 4)) == "ok ok lost lost"
    assert tracker.trajectory().numbers.tolist() == [10, 11]
