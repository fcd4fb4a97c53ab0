"""The trackers that replay poses: which pose goes to which frame, and what they refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.geometry import se3
from bench.io.trajectories import write_kitti, write_tum
from bench.registry import lookup
from bench.types import StereoCamera, StereoFrame, TrackingResult, Trajectory

BLANK = np.zeros((240, 480, 3), np.uint8)


def poses(count: int) -> np.ndarray:
    return se3.exp(np.random.default_rng(1).normal(size=(count, 6)))


def tracker(name: str, **settings: Any) -> Tracker:
    plugin = lookup("tracker", name)
    return plugin.cls(plugin.config(name=name, **settings))


def replay(replayer: Tracker, dataset: Any) -> list[TrackingResult]:
    replayer.start(dataset)
    return [replayer.track(dataset.frame(i)) for i in range(len(dataset))]


@pytest.fixture
def frames(make_dataset: Any, small_camera: StereoCamera) -> Any:
    """Frames 4, 5, 7 at 0.4, 0.5, 0.7 s."""
    return make_dataset(small_camera, [(BLANK, BLANK)] * 3, [4, 5, 7], poses(3))


def test_groundtruth_gives_each_frame_its_pose(frames: Any) -> None:
    replayer = tracker("groundtruth")
    replayer.start(frames)
    second = replayer.track(frames.frame(1))
    np.testing.assert_array_equal(second.T_world_cam, poses(3)[1])
    assert second.state == "ok"
    assert second.landmarks is None
    assert replayer.trajectory().numbers.tolist() == [5]


def test_groundtruth_with_an_error_that_changes_evenly(make_dataset: Any, small_camera: StereoCamera) -> None:
    count, settings = 2001, {"noise_m": 0.02, "noise_deg": 0.3, "noise_frames": 4}
    still = np.tile(np.eye(4), (count, 1, 1))
    dataset = make_dataset(small_camera, [(BLANK, BLANK)] * count, list(range(count)), still)
    errors = []
    for _ in range(2):
        replayer = tracker("groundtruth", **settings)
        replayer.start(dataset)
        poses = [replayer.track(StereoFrame(number, number / 10, BLANK)).T_world_cam for number in range(count)]
        errors.append(se3.log(np.stack(poses)))
    np.testing.assert_array_equal(*errors)
    np.testing.assert_array_equal(errors[0][0], 0)
    np.testing.assert_allclose(errors[0][2], (errors[0][0] + errors[0][4]) / 2, atol=1e-12)
    np.testing.assert_allclose(errors[0][4::4, :3].std(), 0.02, rtol=0.05)
    np.testing.assert_allclose(errors[0][4::4, 3:].std(), np.deg2rad(0.3), rtol=0.05)


def test_groundtruth_says_when_there_is_none(make_dataset: Any, small_camera: StereoCamera) -> None:
    dataset = make_dataset(small_camera, [(BLANK, BLANK)])
    with pytest.raises(BenchError, match=r"memory has no ground-truth poses\. Use tracker=stereo_orb"):
        tracker("groundtruth").start(dataset)


def test_kitti_file_of_the_whole_sequence_goes_by_number(tmp_path: Path, frames: Any) -> None:
    write_kitti(tmp_path / "06.txt", poses(9))
    replayer = tracker("trajectory_file", path=str(tmp_path / "06.txt"))
    results = replay(replayer, frames)
    for result, number in zip(results, (4, 5, 7), strict=True):
        np.testing.assert_allclose(result.T_world_cam, poses(9)[number], atol=1e-14)
    assert [[event.values["text"] for event in result.events] for result in results] == [
        ["06.txt has 9 poses for 3 frames: line k (from 0) is of frame k"],
        [],
        [],
    ]
    assert replayer.trajectory().numbers.tolist() == [4, 5, 7]
    np.testing.assert_allclose(replayer.trajectory().timestamps, [0.4, 0.5, 0.7])


def test_kitti_file_with_one_line_a_frame_goes_by_position(tmp_path: Path, frames: Any) -> None:
    write_kitti(tmp_path / "part.txt", poses(3))
    results = replay(tracker("trajectory_file", path=str(tmp_path / "part.txt"), format="kitti"), frames)
    np.testing.assert_allclose([r.T_world_cam for r in results], poses(3), atol=1e-14)


def test_kitti_file_that_is_too_short(tmp_path: Path, frames: Any) -> None:
    write_kitti(tmp_path / "short.txt", poses(5))
    with pytest.raises(BenchError, match=r"has 5 poses, but memory has 3 frames numbered up to 7"):
        tracker("trajectory_file", path=str(tmp_path / "short.txt")).start(frames)


def test_tum_file_goes_by_the_nearest_time(tmp_path: Path, frames: Any) -> None:
    times = np.array([0.3, 0.405, 0.409, 0.6, 0.692])
    write_tum(tmp_path / "t.txt", Trajectory(poses(5), np.arange(5), times))
    replayer = tracker("trajectory_file", path=str(tmp_path / "t.txt"))
    results = replay(replayer, frames)
    np.testing.assert_allclose(results[0].T_world_cam, poses(5)[1], atol=1e-14)
    assert results[1].state == "lost"
    assert results[1].T_world_cam is None
    np.testing.assert_allclose(results[2].T_world_cam, poses(5)[4], atol=1e-14)
    assert replayer.trajectory().numbers.tolist() == [4, 7]


def test_tum_quaternion_order_is_xyzw(tmp_path: Path, make_dataset: Any, small_camera: StereoCamera) -> None:
    (tmp_path / "turn.txt").write_text("0.0 1 2 3 0 0.7071067811865476 0 0.7071067811865476\n")
    dataset = make_dataset(small_camera, [(BLANK, BLANK)])
    (result,) = replay(tracker("trajectory_file", path=str(tmp_path / "turn.txt")), dataset)
    quarter_turn_about_y = [[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(result.T_world_cam, quarter_turn_about_y, atol=1e-15)


@pytest.mark.parametrize("times", [[100.0, 101.0], [0.44, 0.6]])
def test_tum_file_of_another_clock(tmp_path: Path, frames: Any, times: list[float]) -> None:
    write_tum(tmp_path / "t.txt", Trajectory(poses(2), np.arange(2), np.array(times)))
    with pytest.raises(BenchError, match=r"tolerance 0\.01 s"):
        replay(tracker("trajectory_file", path=str(tmp_path / "t.txt")), frames)


def test_tum_file_can_go_by_index(tmp_path: Path, frames: Any) -> None:
    write_tum(tmp_path / "t.txt", Trajectory(poses(9), np.arange(9), np.arange(9.0)))
    results = replay(tracker("trajectory_file", path=str(tmp_path / "t.txt"), match="index"), frames)
    np.testing.assert_allclose([r.T_world_cam for r in results], poses(9)[[4, 5, 7]], atol=1e-14)


def drive(count: int) -> np.ndarray:
    """1 m forward a frame."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 2, 3] = np.arange(count)
    return T


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.message for record in caplog.records if record.levelname == "WARNING"]


def told(plugin: Any, dataset: Any) -> list[str]:
    """The warnings among the events of all frames."""
    events = [event for result in replay(plugin, dataset) for event in result.events]
    return [event.values["text"] for event in events if event.kind == "warning"]


@pytest.fixture
def twenty(make_dataset: Any, small_camera: StereoCamera) -> Any:
    """Frames 0 to 19 at 10 Hz."""
    return make_dataset(small_camera, [(BLANK, BLANK)] * 20)


def test_gaps_are_told_once_each(tmp_path: Path, twenty: Any, caplog: pytest.LogCaptureFixture) -> None:
    kept = np.array([2, 3, 4, 5, 9, 10, 11, 12, 13, 14, 15, 16])
    file = tmp_path / "t.txt"
    write_tum(file, Trajectory(drive(20)[kept], kept, 0.1 * kept))
    results = replay(tracker("trajectory_file", path=str(file)), twenty)
    assert [i for i, result in enumerate(results) if result.state == "lost"] == [0, 1, 6, 7, 8, 17, 18, 19]
    assert warnings(caplog) == [
        f"frame 0: {file} begins only at 0.200 s; no pose within 0.01 s of 0.000 s",
        f"frame 6: {file} has a gap from 0.500 to 0.900 s; no pose within 0.01 s of 0.600 s",
        f"frame 17: {file} ends at 1.600 s already; no pose within 0.01 s of 1.700 s",
    ]


def test_a_file_of_keyframes_only(tmp_path: Path, twenty: Any) -> None:
    write_tum(tmp_path / "t.txt", Trajectory(drive(20)[::3], np.arange(7), 0.3 * np.arange(7)))
    assert told(tracker("trajectory_file", path=str(tmp_path / "t.txt")), twenty) == [
        "t.txt has 7 poses for 20 frames, so most frames are lost; a file of keyframes only?"
    ]


def test_a_complete_file_is_taken_without_a_word(tmp_path: Path, twenty: Any, caplog: pytest.LogCaptureFixture) -> None:
    write_tum(tmp_path / "t.txt", Trajectory(drive(20), np.arange(20), 0.1 * np.arange(20)))
    write_kitti(tmp_path / "k.txt", drive(20))
    for name in ("t.txt", "k.txt"):
        results = replay(tracker("trajectory_file", path=str(tmp_path / name)), twenty)
        assert {result.state for result in results} == {"ok"}
        assert not [result.events for result in results if result.events]
    assert warnings(caplog) == []


@pytest.mark.parametrize(
    ("turned", "words"),
    [
        (np.linalg.inv(drive(20)), "the poses look like world to camera, or the camera drives backwards"),
        (
            drive(20) @ np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]]),
            "the poses look like those of a body frame (x forward, z up); ours have x right, y down, z forward",
        ),
    ],
)
def test_poses_of_another_convention_are_warned_of(tmp_path: Path, twenty: Any, turned: np.ndarray, words: str) -> None:
    write_kitti(tmp_path / "k.txt", turned)
    (text,) = told(tracker("trajectory_file", path=str(tmp_path / "k.txt")), twenty)
    assert text.startswith(f"k.txt: {words}")
    assert text.endswith("Convert the file if that is so.")


def test_quaternions_with_w_first_are_warned_of(tmp_path: Path, twenty: Any) -> None:
    text = "".join(f"{0.1 * i:.1f} 0 0 {i} 1 0 0 0\n" for i in range(20))
    (tmp_path / "t.txt").write_text(text)
    assert told(tracker("trajectory_file", path=str(tmp_path / "t.txt")), twenty) == [
        "t.txt: the quaternions look like qw qx qy qz; TUM's order is qx qy qz qw. Convert the file if that is so."
    ]


GOOD = "0.0 0 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (GOOD + "0.1 0 0 1 0 0 0 2\n", "FILE, line 2: the quaternion has length 2, not 1. Expected qx qy qz qw in"),
        (GOOD + "0.2 0 0 1 0 0 0 1\n0.1 0 0 2 0 0 0 1\n", "FILE, line 3: the timestamp 0.1 is not after the one"),
        (GOOD + GOOD, "FILE, line 2: the timestamp 0.0 is not after the one before. Sort it by time."),
        (GOOD + "0.1 0 0 1 0 0 0\n", "FILE, line 2: found 7 values, expected 8 numbers: timestamp tx ty tz qx qy qz"),
        (GOOD + "0.1 0 0 x 0 0 0 1\n", "FILE, line 2: could not convert string to float: 'x'; expected 8 numbers"),
        ("# only a comment\n", "FILE has 0 values in its first line; KITTI has 12 and TUM 8."),
        (
            "".join(f"{i} 0 0 {i} 0 0 0 1\n" for i in range(20)),
            "FILE: its times 0, 1, ... are frame numbers, not seconds. Use tracker.match=index, or write times.",
        ),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 19, "FILE has 19 poses, but memory has 20 frames numbered up to 19. It needs"),
        ("1 0 0 0 0 1 0 0 0 0 1 nan\n" * 20, "FILE holds no pose: each of its 20 lines is NaN or zero."),
        ("1 0 0 0 0 1 0 0 0 0 2 0\n" * 20, "FILE, line 1: the 3x3 part is not a rotation. Expected T_world_cam"),
    ],
)
def test_a_wrong_file_is_an_error_that_says_where(tmp_path: Path, twenty: Any, content: str, sentence: str) -> None:
    file = tmp_path / "wrong.txt"
    file.write_text(content)
    with pytest.raises(BenchError) as error:
        tracker("trajectory_file", path=str(file)).start(twenty)
    assert str(error.value).startswith(sentence.replace("FILE", str(file)))


def test_wrong_settings_are_named(tmp_path: Path, frames: Any) -> None:
    with pytest.raises(BenchError, match=r"tracker\.format='tumm' is not one of auto, kitti, tum\. Did you mean 'tum'"):
        tracker("trajectory_file", path="x", format="tumm")
    with pytest.raises(BenchError, match=r"tracker\.match='times' is not one of .*Did you mean 'time'"):
        tracker("trajectory_file", path="x", match="times")
    write_kitti(tmp_path / "k.txt", poses(3))
    with pytest.raises(BenchError, match=r"tracker\.match=time: .*k\.txt is in KITTI's format, which has no times"):
        tracker("trajectory_file", path=str(tmp_path / "k.txt"), match="time").start(frames)
    with pytest.raises(BenchError, match=r"needs tracker\.path=FILE"):
        tracker("trajectory_file")
    with pytest.raises(BenchError, match=r"none\.txt does not exist"):
        tracker("trajectory_file", path=str(tmp_path / "none.txt")).start(frames)
    (tmp_path / "odd.txt").write_text("1 2 3\n")
    with pytest.raises(BenchError, match=r"has 3 values in its first line; KITTI has 12 and TUM 8"):
        tracker("trajectory_file", path=str(tmp_path / "odd.txt")).start(frames)
