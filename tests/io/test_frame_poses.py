"""Poses beside images: a drive along a known line, so that a pose tells from which frame or time it was taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.io.frame_names import NamedFiles, in_order
from bench.io.frame_poses import poses_of_images, read_times


def images(*stems: str) -> NamedFiles:
    return in_order([Path(f"{stem}.png") for stem in stems])


def tum(path: Path, times: np.ndarray) -> Path:
    """At time t the camera is at x = 10 t."""
    path.write_text("".join(f"{t:.6f} {10 * t:.6f} 0 0 0 0 0 1\n" for t in times))
    return path


def kitti(path: Path, count: int, unknown: tuple[int, ...] = ()) -> Path:
    """In line i the camera is at x = i."""
    lines = [f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" if i not in unknown else "nan " * 12 + "\n" for i in range(count)]
    path.write_text("".join(lines))
    return path


@pytest.mark.parametrize(
    ("stems", "count", "x"),
    [
        (["0", "1", "2"], 3, [0, 1, 2]),
        (["7", "8", "9"], 3, [0, 1, 2]),
        (["0", "1", "2"], 40, [0, 1, 2]),
        (["7", "8", "20"], 21, [7, 8, 20]),
        (["a", "b"], 2, [0, 1]),
    ],
)
def test_lines(tmp_path: Path, stems: list[str], count: int, x: list[int]) -> None:
    found = poses_of_images(kitti(tmp_path / "p.txt", count), images(*stems), None)
    assert found.T_world_cam[:, 0, 3].tolist() == x
    assert len(found.remarks) == (len(stems) != count)


@pytest.mark.parametrize(
    ("stems", "count"), [(["0", "1", "2"], 2), (["7", "8"], 8), (["1", "2"], 9), (["a", "b"], 3), (["0.1", "0.2"], 9)]
)
def test_other_numbers_of_lines_are_refused(tmp_path: Path, stems: list[str], count: int) -> None:
    with pytest.raises(BenchError, match=rf"has {count} poses, but there are {len(stems)} images"):
        poses_of_images(kitti(tmp_path / "p.txt", count), images(*stems), None)


def test_a_line_of_nan_is_a_frame_without_pose(tmp_path: Path) -> None:
    found = poses_of_images(kitti(tmp_path / "p.txt", 4, unknown=(1,)), images("0", "1", "2", "3"), None)
    assert np.isnan(found.T_world_cam[:, 0, 3]).tolist() == [False, True, False, False]
    assert found.T_world_cam[3, 0, 3] == 3


@pytest.mark.parametrize("rate", [10, 20, 25, 100])
def test_poses_of_any_rate_go_by_time(tmp_path: Path, rate: int) -> None:
    stamps = images("100.02", "100.12", "100.22", "100.32")
    found = poses_of_images(tum(tmp_path / "p.txt", 99.9 + np.arange(2 * rate) / rate), stamps, stamps.times)
    np.testing.assert_allclose(found.T_world_cam[:, 0, 3], [1000.2, 1001.2, 1002.2, 1003.2], atol=1e-5)


def test_an_outage_leaves_frames_without_pose(tmp_path: Path) -> None:
    times = np.arange(100) / 100.0
    path = tum(tmp_path / "p.txt", np.delete(times, np.arange(18, 43)))
    stamps = images(*(f"0.{tenth}5" for tenth in range(9)))
    found = poses_of_images(path, stamps, stamps.times)
    assert np.flatnonzero(np.isnan(found.T_world_cam[:, 0, 3])).tolist() == [2, 3]
    path.write_text(
        "".join(f"{t} nan nan nan 0 0 0 0\n" if 0.17 < t < 0.43 else f"{t} {t} 0 0 0 0 0 1\n" for t in times)
    )
    again = poses_of_images(path, stamps, stamps.times)
    assert np.flatnonzero(np.isnan(again.T_world_cam[:, 0, 3])).tolist() == [2, 3]


def test_nanoseconds_in_names_and_in_the_file(tmp_path: Path) -> None:
    stamps = images("1403636579763555584", "1403636579863555584", "1403636579963555584")
    (tmp_path / "s.txt").write_text("".join(f"1403636579.{n}63555584 {n} 0 0 0 0 0 1\n" for n in (7, 8, 9)))
    (tmp_path / "ns.txt").write_text("".join(f"1403636579{n}63555584 {n} 0 0 0 0 0 1\n" for n in (7, 8, 9)))
    for name in ("s.txt", "ns.txt"):
        found = poses_of_images(tmp_path / name, stamps, stamps.times)
        np.testing.assert_allclose(found.T_world_cam[:, 0, 3], [7, 8, 9], atol=1e-4)


def test_poses_by_time_need_times(tmp_path: Path) -> None:
    numbered, path = images("0", "1", "2"), tum(tmp_path / "p.txt", np.arange(30) / 100)
    with pytest.raises(BenchError, match=r"has 30 poses by time for 3 images without times\. .*dataset\.times=FILE"):
        poses_of_images(path, numbered, None)
    with pytest.raises(BenchError, match=r"nowhere near the images', 1000\.000 to 1002\.000 s"):
        poses_of_images(path, numbered, np.array([1000.0, 1001.0, 1002.0]))
    (tmp_path / "times.txt").write_text("\ufeff# s, file\n0.05 a.png\n0.1,b.png\n0.15\n", encoding="utf-8")
    times, remarks = read_times(tmp_path / "times.txt", numbered)
    assert remarks == ()
    np.testing.assert_allclose(poses_of_images(path, numbered, times).T_world_cam[:, 0, 3], [0.5, 1.0, 1.5])
    one_each = poses_of_images(tum(path, np.array([5.0, 5.1, 5.2])), numbered, None)
    assert one_each.times is not None
    np.testing.assert_allclose(one_each.times, [5.0, 5.1, 5.2])
