"""The trackers that replay poses: which pose goes to which frame, and what they refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.geometry import se3
from bench.geometry.trajectory_io import write_kitti, write_tum
from bench.registry import lookup
from bench.types import StereoCamera, TrackingResult, Trajectory

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


def test_wrong_settings_are_named(tmp_path: Path, frames: Any) -> None:
    with pytest.raises(BenchError, match=r"tracker\.format='tumm' is not one of auto, kitti, tum\. Did you mean 'tum'"):
        tracker("trajectory_file", path="x", format="tumm")
    with pytest.raises(BenchError, match=r"needs tracker\.path=FILE"):
        tracker("trajectory_file")
    with pytest.raises(BenchError, match=r"tracker\.path=.*none\.txt does not exist"):
        tracker("trajectory_file", path=str(tmp_path / "none.txt")).start(frames)
    (tmp_path / "odd.txt").write_text("1 2 3\n")
    with pytest.raises(BenchError, match=r"has 3 values in its first line; KITTI has 12 and TUM 8"):
        tracker("trajectory_file", path=str(tmp_path / "odd.txt")).start(frames)
