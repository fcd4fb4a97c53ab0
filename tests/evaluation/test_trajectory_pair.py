"""Which poses of two files belong together: by line, by time, with gaps, and what can't be matched."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.evaluation.score import score_pair
from bench.evaluation.trajectory_pair import detect_format, read_pair
from bench.io.trajectories import write_kitti, write_tum
from bench.types import Trajectory


def curve(times: np.ndarray) -> np.ndarray:
    """Poses of a car on a circle of 50 m at 10 m/s, at any times."""
    T = np.tile(np.eye(4), (len(times), 1, 1))
    angle = times / 5.0
    T[:, 0, 3], T[:, 2, 3] = 50.0 * (1 - np.cos(angle)), 50.0 * np.sin(angle)
    T[:, 0, 0] = T[:, 2, 2] = np.cos(angle)
    T[:, 0, 2], T[:, 2, 0] = np.sin(angle), -np.sin(angle)
    return T


def tum(path: Path, times: np.ndarray, poses: np.ndarray | None = None) -> Path:
    write_tum(path, Trajectory(curve(times) if poses is None else poses, np.arange(len(times)), times))
    return path


def kitti(path: Path, times: np.ndarray) -> Path:
    write_kitti(path, curve(times))
    return path


def test_two_kitti_files_are_matched_by_line(tmp_path: Path) -> None:
    times = 0.1 * np.arange(40)
    pair = read_pair(kitti(tmp_path / "a.txt", times), kitti(tmp_path / "b.txt", times))
    assert np.allclose(pair.estimate.T_world_cam, pair.ground_truth.T_world_cam)
    assert (len(pair.estimate), pair.outside, pair.without_truth, pair.matched_by) == (40, 0, 0, "line")


def test_lines_of_the_ground_truth_can_be_chosen(tmp_path: Path) -> None:
    times = 0.1 * np.arange(40)
    whole = kitti(tmp_path / "b.txt", times)
    pair = read_pair(kitti(tmp_path / "a.txt", times[10:20]), whole, frames="10:20")
    assert (pair.ground_truth.numbers[[0, -1]].tolist(), pair.outside) == ([10, 19], 30)
    assert score_pair(pair, "none").metrics["trajectory"]["ate_max_m"] == pytest.approx(0.0, abs=1e-9)
    every_third = read_pair(kitti(tmp_path / "c.txt", times[1::3]), whole, frames="1::3")
    trajectory = score_pair(every_third, "none").metrics["trajectory"]
    assert (trajectory["ate_max_m"], trajectory["rpe_pairs"]) == (pytest.approx(0.0, abs=1e-9), 12)
    for frames, message in (
        ("10:25", "has 10 poses and .*b.txt --frames 10:25 names 15 of its lines"),
        ("35:45", "--frames 35:45 asks for lines that .*b.txt lacks: it has 40"),
        ("45:", "--frames 45: asks for lines"),
        ("ten", "--frames 'ten' is no range of frames: write --frames first:end"),
        ("5:5", "--frames '5:5' holds no frame"),
    ):
        with pytest.raises(BenchError, match=message):
            read_pair(tmp_path / "a.txt", whole, frames=frames)


def test_lost_frames_in_time_are_gaps_in_the_list_of_frames(tmp_path: Path) -> None:
    """Ground truth at the camera's rate, clocks 2 ms apart: its lines are the frames. 3 to 5 and 9 are lost."""
    times = 0.1 * np.arange(20)
    kept = np.array([2, 6, 7, 8, 10, 11, 12, 13, 14, 15, 16])
    pair = read_pair(tum(tmp_path / "a", times[kept] + 0.002, curve(times[kept])), tum(tmp_path / "b", times))
    assert pair.estimate.numbers.tolist() == kept.tolist()
    assert pair.ground_truth.numbers.tolist() == list(range(2, 17))
    assert pair.outside == 2 + 3
    frames = score_pair(pair, "se3").metrics["frames"]
    assert (frames["total"], frames["tracked"], frames["lost"]) == (15, 11, 4)
    assert frames["lost_stretches"] == [[3, 5], [9, 9]]


def test_motion_capture_is_no_list_of_frames(tmp_path: Path) -> None:
    """Ground truth at 100 Hz beside a camera at 10 Hz: gaps show in the estimate's own rhythm."""
    dense = 0.01 * np.arange(700)
    times = 1.0 + 0.1 * np.arange(50)
    kept = np.array([i for i in range(50) if i not in (20, 21, 22, 40)])
    pair = read_pair(tum(tmp_path / "a", times[kept] + 0.001), tum(tmp_path / "b", dense))
    assert pair.estimate.numbers.tolist() == kept.tolist()
    assert pair.ground_truth.numbers.tolist() == list(range(50))
    score = score_pair(pair, "none")
    assert score.metrics["frames"]["lost_stretches"] == [[20, 22], [40, 40]]
    # 1 ms at 10 m/s, all along the path.
    assert score.metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0.01, abs=1e-4)
    assert (score.metrics["trajectory"]["rpe_pairs"], score.metrics["trajectory"]["rpe_pairs_lost"]) == (43, 6)
    # A second and eleven tenths before and after.
    assert pair.outside == 10 + 10


def test_poses_that_share_a_ground_truth_or_have_none(tmp_path: Path) -> None:
    """At 20 Hz against 10 Hz every other pose is 50 ms off; of two within the tolerance the nearest counts."""
    slow, fast = 0.1 * np.arange(20), 0.05 * np.arange(39)
    truth, estimate = tum(tmp_path / "b", slow), tum(tmp_path / "a", fast)
    pair = read_pair(estimate, truth)
    assert (len(pair.estimate), pair.without_truth) == (20, 19)
    loose = read_pair(estimate, truth, max_time_difference_s=0.06)
    assert np.allclose(loose.estimate.T_world_cam, loose.ground_truth.T_world_cam)
    assert score_pair(loose, "none").metrics["notes"]["without_truth"].startswith("19 poses of the trajectory")


def test_a_kitti_file_gets_times_beside_a_tum_file(tmp_path: Path) -> None:
    times = 0.1 * np.arange(30)
    (tmp_path / "times.txt").write_text("".join(f"{time:.6e}\n" for time in times))
    kept = np.delete(np.arange(30), [4, 5])
    estimate, truth = tum(tmp_path / "a", times[kept]), kitti(tmp_path / "b", times)
    pair = read_pair(estimate, truth, times_path=tmp_path / "times.txt")
    assert np.allclose(pair.estimate.T_world_cam, curve(times[kept]))
    assert pair.ground_truth.numbers.tolist() == list(range(30))
    with pytest.raises(BenchError, match=r"b is a KITTI file, which has no times.*--times FILE"):
        read_pair(estimate, truth)
    (tmp_path / "times.txt").write_text("0\n1\n")
    with pytest.raises(BenchError, match=r"times.txt has 2 times and .*b 30 poses; one a pose is needed"):
        read_pair(estimate, truth, times_path=tmp_path / "times.txt")


def test_settings_that_do_not_fit_the_files(tmp_path: Path) -> None:
    times = 0.1 * np.arange(30)
    a, b = tum(tmp_path / "a", times), kitti(tmp_path / "b", times)
    for first, second, settings, message in (
        (b, b, {"times_path": a}, r"--times is of no use for two KITTI files"),
        (a, a, {"times_path": b}, r"--times is of no use for two TUM files"),
        (a, a, {"frames": "0:3"}, r"--frames is for two KITTI files"),
        (a, a, {"max_time_difference_s": 0.0}, r"--max-time-difference 0.0 must be a number of seconds above 0"),
        (a, a, {"max_time_difference_s": float("nan")}, r"--max-time-difference nan must be"),
        (a, b, {"form": "kitti"}, r"a, line 1: found 8 values, expected 12 numbers"),
        (b, a, {"form": "tum"}, r"b, line 1: found 12 values, expected 8 numbers"),
    ):
        with pytest.raises(BenchError, match=message):
            read_pair(first, second, **settings)  # type: ignore[arg-type]


def test_files_that_do_not_belong_together(tmp_path: Path) -> None:
    times = 0.1 * np.arange(30)
    a, late = tum(tmp_path / "a", times), tum(tmp_path / "late", times + 1000.0)
    with pytest.raises(BenchError, match=r"0 poses are within 0\.01 s .*a: 0\.000 to 2\.900 s; .*late: 1000\.000 to"):
        read_pair(a, late)
    b, longer = kitti(tmp_path / "b", times), kitti(tmp_path / "longer", 0.1 * np.arange(31))
    with pytest.raises(BenchError, match=r"b has 30 poses and .*longer has 31\. .*line by line.*--frames FIRST:END"):
        read_pair(b, longer)
    few = kitti(tmp_path / "few", times[:2])
    with pytest.raises(BenchError, match="There is no ATE: only 2 tracked frames have ground truth"):
        score_pair(read_pair(few, few), "se3")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"file does not exist\. Check the path"),
        (b"", "holds no pose"),
        (b"# nothing\n\n", "holds no pose"),
        (b"1 2 3\n", r"has 3 values in its first line; KITTI has 12 and TUM 8"),
        (b"1,0,0,0,0,1,0,0,0,0,1,0\n", "has 1 values in its first line"),
        (b"\xff\xff\x00\x01", "It must be a text file"),
    ],
)
def test_files_of_no_known_format(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "file"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BenchError, match=message):
        detect_format(path)


def test_comments_come_before_a_tum_file(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("# time x y z qx qy qz qw\n\n0 0 0 0 0 0 0 1\n")
    assert detect_format(tmp_path / "a") == "tum"
