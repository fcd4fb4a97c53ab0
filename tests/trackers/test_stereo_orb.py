"""Stereo odometry on a made-up wall, on real KITTI frames, and on images that show nothing."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PosePath3D

from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.registry import lookup
from bench.types import StereoFrame, TrackingResult, Trajectory


def stereo_orb(**settings: Any) -> Tracker:
    plugin = lookup("tracker", "stereo_orb")
    return plugin.cls(plugin.config(name="stereo_orb", **settings))


def drive(tracker: Tracker, dataset: Any, positions: list[int], renumber: bool = False) -> list[TrackingResult]:
    """Track the frames at ``positions``; ``renumber`` gives them evenly spaced times, whatever their places are."""
    tracker.start(dataset)
    results = []
    for i, position in enumerate(positions):
        frame = dataset.frame(position)
        results.append(tracker.track(StereoFrame(i, 0.1 * i, frame.left, frame.right) if renumber else frame))
    return results


def blank(frame: StereoFrame, value: int = 0) -> StereoFrame:
    return StereoFrame(frame.number, frame.timestamp, np.full_like(frame.left, value), np.full_like(frame.right, value))


def centres(results: list[TrackingResult]) -> np.ndarray:
    return np.array([r.T_world_cam[:3, 3] for r in results if r.T_world_cam is not None])


def evo_ate(trajectory: Trajectory, truth: np.ndarray) -> float:
    """ATE RMSE by evo: SE(3) alignment without scale."""
    estimate, reference = PosePath3D(poses_se3=list(trajectory.T_world_cam)), PosePath3D(poses_se3=list(truth))
    estimate.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    return float(ape.get_statistic(metrics.StatisticsType.rmse))


@pytest.fixture(scope="module")
def kitti_run(kitti_grey: Any) -> tuple[list[TrackingResult], Trajectory]:
    tracker = stereo_orb()
    return drive(tracker, kitti_grey, list(range(51))), tracker.trajectory()


def test_wall_is_passed_at_the_right_speed(wall: Any) -> None:
    tracker = stereo_orb(keypoints=800)
    results = drive(tracker, wall, list(range(12)))
    assert [r.state for r in results] == ["ok"] * 12
    truth = wall.ground_truth().T_world_cam
    np.testing.assert_allclose(centres(results), truth[:, :3, 3], atol=0.04)
    np.testing.assert_allclose(tracker.trajectory().T_world_cam[:, :3, :3], truth[:, :3, :3], atol=5e-3)
    np.testing.assert_array_equal(results[0].T_world_cam, np.eye(4))


def test_landmarks_follow_the_wall(wall: Any) -> None:
    results = drive(stereo_orb(keypoints=800), wall, list(range(4)))
    for before, now in itertools.pairwise(results):
        assert before.landmarks is not None
        assert now.landmarks is not None
        assert len(np.unique(now.landmarks)) == len(now.landmarks) >= now.inliers > 0
        assert len(np.intersect1d(before.landmarks, now.landmarks)) > 50


def test_real_street_is_tracked_to_centimetres(kitti_run: Any, kitti_grey: Any) -> None:
    results, trajectory = kitti_run
    truth = kitti_grey.ground_truth().T_world_cam
    assert [r.state for r in results] == ["ok"] * 51
    assert trajectory.numbers.tolist() == list(range(51))
    assert evo_ate(trajectory, truth) <= 0.10
    online = Trajectory(np.array([r.T_world_cam for r in results]), trajectory.numbers, trajectory.timestamps)
    assert evo_ate(online, truth) <= 0.10


def test_motion_from_frame_to_frame_agrees_with_orbslam2(kitti_run: Any, test_data: Any) -> None:
    """Real ORB-SLAM2 runs differ from each other by 6 to 18 mm and 0.02 to 0.045 degrees per frame on this stretch."""
    ours = kitti_run[1].T_world_cam
    table = np.loadtxt(test_data / "trajectories" / "orbslam2_stereo" / "06_trial4.txt")[:51].reshape(-1, 3, 4)
    theirs = np.tile(np.eye(4), (51, 1, 1))
    theirs[:, :3] = table
    step = [np.linalg.inv(T[:-1]) @ T[1:] for T in (ours, theirs)]
    difference = np.linalg.inv(step[0]) @ step[1]
    cosine = (np.trace(difference[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    assert np.sqrt((difference[:, :3, 3] ** 2).sum(1).mean()) < 0.015
    assert np.degrees(np.sqrt((np.arccos(np.clip(cosine, -1, 1)) ** 2).mean())) < 0.04


def test_two_runs_give_the_same_bits(kitti_run: Any, kitti_grey: Any) -> None:
    again = drive(stereo_orb(), kitti_grey, list(range(15)))
    for first, second in zip(kitti_run[0], again, strict=False):
        assert np.array_equal(first.T_world_cam, second.T_world_cam)
        assert np.array_equal(first.landmarks, second.landmarks)
        assert (first.inliers, first.state) == (second.inliers, second.state)


def test_jump_of_five_metres_is_caught_up(kitti_grey: Any) -> None:
    positions = [0, 1, 2, 3, 4, 9, 10, 11]
    results = drive(stereo_orb(), kitti_grey, positions, renumber=True)
    truth = kitti_grey.ground_truth().T_world_cam[positions, :3, 3]
    assert [r.state for r in results] == ["ok"] * 8
    np.testing.assert_allclose(np.linalg.norm(centres(results), axis=1), np.linalg.norm(truth, axis=1), atol=0.2)


def test_standing_car_stays_where_it_is(kitti_grey: Any) -> None:
    results = drive(stereo_orb(), kitti_grey, [0, 1, 2, 2, 2, 2, 2], renumber=True)
    assert [r.state for r in results] == ["ok"] * 7
    np.testing.assert_allclose(centres(results)[3:], np.tile(centres(results)[2], (4, 1)), atol=0.03)


def test_two_black_frames_are_bridged(kitti_grey: Any) -> None:
    tracker = stereo_orb()
    tracker.start(kitti_grey)
    frames = [kitti_grey.frame(i) for i in range(8)]
    frames[4], frames[5] = blank(frames[4]), blank(frames[5], 255)
    results = [tracker.track(frame) for frame in frames]
    assert [r.state for r in results] == ["ok"] * 4 + ["lost"] * 2 + ["ok"] * 2
    seen = [0, 1, 2, 3, 6, 7]
    truth = kitti_grey.ground_truth().T_world_cam[seen, :3, 3]
    found = centres([results[i] for i in seen])
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(truth, axis=1), atol=0.2)


def test_after_a_loss_a_new_map_begins_where_the_car_should_be(kitti_grey: Any) -> None:
    tracker = stereo_orb(bridge_frames=2)
    tracker.start(kitti_grey)
    results = [tracker.track(kitti_grey.frame(i)) for i in range(4)]
    results += [tracker.track(blank(kitti_grey.frame(i))) for i in range(4, 12)]
    results += [tracker.track(kitti_grey.frame(i)) for i in range(12, 16)]
    assert [r.state for r in results] == ["ok"] * 4 + ["lost"] * 9 + ["ok"] * 3
    assert all((r.T_world_cam is None) == (r.state == "lost") for r in results)
    last = results[-1].T_world_cam
    assert last is not None
    # Eight blind frames at constant velocity: within 1.5 m after 18 m.
    truth = kitti_grey.ground_truth().T_world_cam[15]
    assert np.linalg.norm(last[:3, 3] - truth[:3, 3]) < 1.5
    assert tracker.trajectory().numbers.tolist() == [0, 1, 2, 3, 13, 14, 15]
    assert np.isfinite(tracker.trajectory().T_world_cam).all()


def test_nothing_but_black_is_lost_and_no_crash(wall: Any) -> None:
    tracker = stereo_orb()
    tracker.start(wall)
    results = [tracker.track(blank(wall.frame(i))) for i in range(10)]
    assert [r.state for r in results] == ["lost"] * 10
    assert len(tracker.trajectory()) == 0


def test_world_is_the_first_frame_that_shows_something(wall: Any) -> None:
    tracker = stereo_orb(keypoints=800)
    tracker.start(wall)
    tracker.track(blank(wall.frame(0)))
    second = tracker.track(wall.frame(1))
    assert second.state == "ok"
    np.testing.assert_array_equal(second.T_world_cam, np.eye(4))


def test_noise_images_don_t_crash(wall: Any) -> None:
    rng = np.random.default_rng(0)
    tracker = stereo_orb(keypoints=500)
    tracker.start(wall)
    for i in range(4):
        left, right = rng.integers(0, 256, (2, 240, 480, 3), dtype=np.uint8)
        result = tracker.track(StereoFrame(i, 0.1 * i, left, right))
        assert result.T_world_cam is None or np.isfinite(result.T_world_cam).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"keypoints": 10}, r"tracker\.keypoints=10 is too small; the least is 100"),
        ({"features": "2000"}, r"tracker\.features=2000: it says which .*; their number is tracker\.keypoints=2000"),
        ({"features": "xfaet"}, r"tracker\.features=.*xfeat"),
        ({"features": "xfeat", "octaves": 4}, r"tracker\.octaves=4 is not for tracker\.features=xfeat; leave it out"),
        ({"device": "cpu"}, r"tracker\.device=cpu is not for tracker\.features=orb"),
        ({"features": "xfeat", "weights": "none.pt"}, r"tracker\.weights=none\.pt is no file"),
        ({"scale_factor": 1.0}, r"tracker\.scale_factor=1\.0 must be above 1"),
        ({"stereo_depth_baselines": 0.0}, r"tracker\.stereo_depth_baselines=0\.0 must be above 0"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        stereo_orb(**settings)
