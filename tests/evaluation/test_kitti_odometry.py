"""t_rel and r_rel: cases worked by hand, a literal loop over the definition, and published figures of ORB-SLAM2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.evaluation.kitti_odometry import SHORT, STANDARD, SegmentErrors, kitti_odometry_error, segment_errors
from bench.io.trajectories import read_kitti_poses
from bench.types import Trajectory


def rotation_about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def trajectory(T: np.ndarray, numbers: np.ndarray | None = None) -> Trajectory:
    numbers = np.arange(len(T)) if numbers is None else numbers
    return Trajectory(T, numbers, 0.1 * numbers)


def straight(step_m: float, n: int) -> np.ndarray:
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 2, 3] = step_m * np.arange(n)
    return T


def scored(estimate: Trajectory, truth: Trajectory) -> SegmentErrors:
    result = kitti_odometry_error(estimate, truth)
    assert isinstance(result, SegmentErrors)
    return result


def by_definition(estimate: np.ndarray, truth: np.ndarray, lengths: tuple[float, ...], every: int) -> np.ndarray:
    """The development kit's procedure, one segment at a time: rows of (first, last, length, t, r)."""
    distance = [0.0]
    for i in range(1, len(truth)):
        distance.append(distance[-1] + float(np.sqrt(((truth[i, :3, 3] - truth[i - 1, :3, 3]) ** 2).sum())))
    rows = []
    for first in range(0, len(truth), every):
        for length in lengths:
            last = first
            while last < len(truth) and not distance[last] > distance[first] + length:
                last += 1
            if last == len(truth):
                continue
            of_truth = np.linalg.inv(truth[first]) @ truth[last]
            of_estimate = np.linalg.inv(estimate[first]) @ estimate[last]
            E = np.linalg.inv(of_estimate) @ of_truth
            angle = np.arccos(np.clip(0.5 * (np.trace(E[:3, :3]) - 1.0), -1.0, 1.0))
            rows.append((first, last, length, np.linalg.norm(E[:3, 3]) / length, angle / length))
    return np.array(rows)


def test_a_scale_error_shows_that_the_end_is_strictly_beyond_the_length() -> None:
    """Steps of 1 m: a segment of L ends after L + 1 of them, so its error is .01 (L + 1) / L. (>= would give 1 %.)"""
    result = scored(trajectory(straight(1.01, 901)), trajectory(straight(1.0, 901)))
    counts = dict(zip(*np.unique(result.length_m, return_counts=True), strict=True))
    assert counts == dict(zip(STANDARD.lengths_m, (80, 70, 60, 50, 40, 30, 20, 10), strict=True))
    assert np.array_equal(result.last, result.first + result.length_m + 1)
    assert result.t_rel_percent == pytest.approx(1.00457242, abs=5e-9)
    assert result.r_rel_deg_per_100m == pytest.approx(0.0, abs=1e-9)
    assert result.metrics()["segment_pairs"] == [80, 70, 60, 50, 40, 30, 20, 10]
    assert result.metrics()["segments_m"] == list(STANDARD.lengths_m)


def test_a_slow_turn_in_degrees_per_100_m() -> None:
    estimate = straight(1.0, 901)
    for i in range(901):
        estimate[i, :3, :3] = rotation_about_y(0.001 * i)
    result = scored(trajectory(estimate), trajectory(straight(1.0, 901)))
    assert result.rotation_rad_per_m.mean() == pytest.approx(0.00100457242, abs=5e-12)
    assert result.r_rel_deg_per_100m == pytest.approx(5.755776, abs=5e-7)


def test_only_the_world_may_differ() -> None:
    """A constant motion in front of all poses changes nothing, one behind them does."""
    rng = np.random.default_rng(0)
    truth = straight(1.0, 300)
    for i in range(1, 300):
        step = np.eye(4)
        step[:3, :3] = rotation_about_y(rng.normal(0, 0.02))
        step[2, 3] = 1.0
        truth[i] = truth[i - 1] @ step
    O = np.eye(4)  # noqa: E741 - the offset
    O[:3, :3], O[:3, 3] = rotation_about_y(0.4), [5.0, -2.0, 1.0]
    moved = scored(trajectory(O @ truth), trajectory(truth))
    assert (moved.t_rel_percent, moved.r_rel_deg_per_100m) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert scored(trajectory(truth @ O), trajectory(truth)).t_rel_percent > 0.1


@pytest.mark.parametrize("name", ["06_trial0", "07_trial3"])
def test_real_trajectories_agree_with_the_definition(test_data: Path, name: str) -> None:
    truth = read_kitti_poses(test_data / "kitti_odometry" / "poses" / f"{name[:2]}.txt")
    estimate = read_kitti_poses(test_data / "trajectories" / "orbslam2_stereo" / f"{name}.txt")
    result = scored(trajectory(estimate), trajectory(truth))
    expected = by_definition(estimate, truth, STANDARD.lengths_m, 10)
    assert np.array_equal(np.column_stack([result.first, result.last, result.length_m]), expected[:, :3])
    assert np.allclose(result.translation, expected[:, 3], rtol=1e-9)
    assert np.allclose(result.rotation_rad_per_m, expected[:, 4], atol=1e-9)
    short = segment_errors(trajectory(estimate[:60]), trajectory(truth[:60]), SHORT)
    assert isinstance(short, SegmentErrors)
    expected = by_definition(estimate[:60], truth[:60], (10.0, 20.0, 30.0, 40.0, 50.0), 1)
    assert len(short.first) == len(expected)
    assert short.translation.mean() == pytest.approx(expected[:, 3].mean(), rel=1e-9)


@pytest.mark.parametrize(("sequence", "t_rel", "r_rel"), [("05", 0.40, 0.16), ("06", 0.51, 0.15), ("07", 0.50, 0.28)])
def test_orbslam2_has_the_figures_of_its_paper(test_data: Path, sequence: str, t_rel: float, r_rel: float) -> None:
    """Mur-Artal and Tardos, "ORB-SLAM2", TRO 2017, table on KITTI; other runs of that system, so not to the digit."""
    truth = trajectory(read_kitti_poses(test_data / "kitti_odometry" / "poses" / f"{sequence}.txt"))
    files = sorted((test_data / "trajectories" / "orbslam2_stereo").glob(f"{sequence}_trial*.txt"))
    assert len(files) == 5
    results = [scored(trajectory(read_kitti_poses(file)), truth) for file in files]
    assert np.mean([result.t_rel_percent for result in results]) == pytest.approx(t_rel, abs=0.025)
    assert np.median([result.r_rel_deg_per_100m for result in results]) == pytest.approx(r_rel, abs=0.02)


def test_a_short_path_has_short_segments_under_names_of_their_own() -> None:
    """59 m in steps of 1 m: segments of 10 m start at frames 0 to 48, those of 50 m at 0 to 8."""
    metrics = scored(trajectory(straight(1.02, 60)), trajectory(straight(1.0, 60))).metrics()
    assert "t_rel_percent" not in metrics
    assert metrics["segments_m"] == [10.0, 20.0, 30.0, 40.0, 50.0]
    assert metrics["segment_pairs"] == [49, 39, 29, 19, 9]
    assert metrics["segment_start_every"] == 1
    expected = sum(2.0 * (L + 1) / L * n for L, n in zip((10, 20, 30, 40, 50), (49, 39, 29, 19, 9), strict=True)) / 145
    assert metrics["t_rel_short_percent"] == pytest.approx(expected)


def test_lengths_that_the_path_does_not_have_are_not_claimed() -> None:
    metrics = scored(trajectory(straight(1.0, 251)), trajectory(straight(1.0, 251))).metrics()
    assert (metrics["segments_m"], metrics["segment_pairs"]) == ([100.0, 200.0], [15, 5])
    # 100 m exactly hold no segment of more than 100 m.
    assert "t_rel_short_percent" in scored(trajectory(straight(1.0, 101)), trajectory(straight(1.0, 101))).metrics()
    assert scored(trajectory(straight(1.0, 102)), trajectory(straight(1.0, 102))).metrics()["segment_pairs"] == [1]


def test_segments_at_lost_frames_are_left_out_and_counted() -> None:
    """Of 251 frames 100 to 119 are lost: two starts, and the ends of segments that start at -1 .. 18 before L."""
    truth = straight(1.0, 251)
    kept = np.array([i for i in range(251) if not 100 <= i < 120])
    result = scored(trajectory(truth[kept], kept), trajectory(truth))
    whole = [(first, first + L + 1) for L in (100, 200) for first in range(0, 250, 10) if first + L + 1 <= 250]
    good = [pair for pair in whole if not any(100 <= frame < 120 for frame in pair)]
    assert sorted(zip(result.first.tolist(), result.last.tolist(), strict=True)) == sorted(good)
    assert result.metrics()["segment_pairs_lost"] == len(whole) - len(good) > 0


def test_what_can_not_be_scored_gives_the_reason() -> None:
    tiny = trajectory(straight(1.0, 11))
    assert kitti_odometry_error(tiny, tiny) == "the path of 10.0 m is not longer than the shortest segment, 10 m"
    truth = trajectory(straight(1.0, 151))
    kept = np.arange(100)
    lost = kitti_odometry_error(trajectory(straight(1.0, 100), kept), truth)
    assert lost == "no segment starts and ends in tracked frames (5 are lost)"
    broken = straight(1.0, 151)
    broken[101, 0, 3] = np.nan
    assert kitti_odometry_error(trajectory(broken), truth) == "the pose of frame 0 or 101 is not finite"
    assert kitti_odometry_error(truth, trajectory(broken)) == "a pose of the ground truth is not finite"
