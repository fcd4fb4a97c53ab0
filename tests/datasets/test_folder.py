"""The user's own pair: numbers in, frames out, and what can be wrong with the folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from plugins.datasets.folder import Folder, FolderConfig
from plugins.trackers.groundtruth import GroundTruth, GroundTruthConfig
from tests.datasets.kitti_disk import write_image


def make(root: Path, count: int = 3, suffix: str = ".png", **settings: Any) -> FolderConfig:
    for number in range(count):
        write_image(root / "left" / f"shot{number}{suffix}", number)
        write_image(root / "right" / f"shot{number}{suffix}", 100 + number)
    given = {"left": str(root / "left"), "right": str(root / "right")}
    return FolderConfig(**{**given, "fx": 50.0, "fy": 51.0, "cx": 31.0, "cy": 12.0, "baseline": 0.2, **settings})


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_reads_pairs_in_order_of_name(tmp_path: Path, suffix: str) -> None:
    folder = Folder(make(tmp_path, suffix=suffix))
    assert folder.numbers == (0, 1, 2)
    camera = folder.camera
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 24, 50.0, 51.0, 31.0, 12.0)
    assert camera.right_position == (0.2, 0.0, 0.0)
    frame = folder.frame(1)
    stored = cv2.imread(str(tmp_path / "right" / f"shot1{suffix}"))
    np.testing.assert_array_equal(frame.right, stored[..., ::-1])
    assert folder.ground_truth() is None


def test_kitti_and_tum_poses_give_the_same(tmp_path: Path) -> None:
    # A quarter turn about y: x goes to -z, z to x; quaternion (x, y, z, w) = (0, sin 45, 0, cos 45).
    half = np.sqrt(0.5)
    (tmp_path / "kitti.txt").write_text("0 0 1 4 0 1 0 5 -1 0 0 6\n" * 3)
    (tmp_path / "tum.txt").write_text("# t x y z q\n" + "".join(f"{9 + t} 4 5 6 0 {half} 0 {half}\n" for t in range(3)))
    truths = []
    for name in ("kitti.txt", "tum.txt"):
        truth = Folder(make(tmp_path, poses=str(tmp_path / name), frames="1:3")).ground_truth()
        assert truth is not None
        truths.append(truth)
        np.testing.assert_allclose(truth.T_world_cam[1][:3], [[0, 0, 1, 4], [0, 1, 0, 5], [-1, 0, 0, 6]], atol=1e-12)
        np.testing.assert_array_equal(truth.numbers, [1, 2])
    np.testing.assert_allclose(truths[1].timestamps, [10.0, 11.0])


def test_wrong_input_is_named(tmp_path: Path) -> None:
    good = make(tmp_path)

    def expect(message: str, **settings: Any) -> None:
        with pytest.raises(BenchError, match=message) as caught:
            Folder(make(tmp_path, **settings))
        assert "\n" not in str(caught.value)

    expect("dataset.fx=0.0 must be positive", fx=0.0)
    expect("dataset.baseline=nan is too small", baseline=float("nan"))
    expect("outside the images of 64x24", cx=500.0)
    expect("dataset.left is not set", left="")
    expect("this folder does not exist", right=str(tmp_path / "gone"))
    expect("holds no PNG or JPEG", right=str(tmp_path))
    expect("frame 3 is missing .* frames 0 to 2", frames="0:5")
    expect("gone.txt does not exist", poses=str(tmp_path / "gone.txt"))
    (tmp_path / "short.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    expect("has 1 poses, but there are 3 images, with numbers 0 to 2", poses=str(tmp_path / "short.txt"))
    write_image(tmp_path / "left" / "shot1.png", 0, height=20)
    with pytest.raises(BenchError, match=r"shot1.png is 64x20 pixels"):
        Folder(good)


def test_truncated_jpeg(tmp_path: Path) -> None:
    config = make(tmp_path, suffix=".jpg")
    path = tmp_path / "left" / "shot2.jpg"
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(BenchError, match=r"shot2.jpg is truncated"):
        Folder(config)


def rename(folder: Path, names: dict[str, str]) -> None:
    for old, new in names.items():
        (folder / old).rename(folder / new)


def test_frames_follow_the_numbers_and_gaps_stay(tmp_path: Path) -> None:
    """Pictures 0 to 3 become 2, 9, 10 and 11: in the order of the alphabet 10 would come first."""
    config = make(tmp_path, count=4)
    for side in ("left", "right"):
        rename(tmp_path / side, {f"shot{i}.png": f"{n}.png" for i, n in enumerate((2, 9, 10, 11))})
    folder = Folder(config)
    assert folder.numbers == (0, 7, 8, 9)
    np.testing.assert_array_equal(folder.frame(1).left, cv2.imread(str(tmp_path / "left" / "9.png"))[..., ::-1])
    assert folder.frame(3).timestamp == pytest.approx(0.9)
    assert folder.remarks == ("the numbers in the names of left skip 6 frames, the first after 2.png",)


def test_a_frame_without_partner_is_left_out_and_told(tmp_path: Path) -> None:
    config = make(tmp_path, count=4, poses=str(tmp_path / "poses.txt"))
    (tmp_path / "poses.txt").write_text("".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(4)))
    (tmp_path / "right" / "shot1.png").unlink()
    folder = Folder(config)
    assert folder.numbers == (0, 2, 3)
    (remark,) = folder.remarks
    assert remark.startswith("1 of 4 images")
    assert remark.endswith("left out: shot1.png")
    truth = folder.ground_truth()
    assert truth is not None
    assert truth.T_world_cam[:, 0, 3].tolist() == [0, 2, 3]
    assert Folder(make(tmp_path / "b", frames="1:3")).numbers == (1, 2)


def test_times_in_names_join_poses_of_another_rate(tmp_path: Path) -> None:
    config = make(tmp_path, poses=str(tmp_path / "poses.txt"))
    for side in ("left", "right"):
        rename(tmp_path / side, {f"shot{i}.png": f"{1403636579100000000 + i * 100000000}.png" for i in range(3)})
    lines = (f"{1403636579 + i / 100:.2f} {i} 0 0 0 0 0 1\n" for i in range(25))
    (tmp_path / "poses.txt").write_text("".join(lines))
    folder = Folder(config)
    truth = folder.ground_truth()
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam[:, 0, 3], [10, 20], atol=1e-4)
    assert truth.numbers.tolist() == [0, 1]
    assert folder.remarks == ("1 of 3 frames have no ground truth: frame 2",)
    assert folder.frame(2).timestamp == pytest.approx(1403636579.3)


@pytest.mark.parametrize("given", [True, False])
def test_a_file_of_times_joins_poses_of_another_rate(tmp_path: Path, given: bool) -> None:
    (tmp_path / "times.txt").write_text("0.1\n0.2\n0.3\n")
    (tmp_path / "poses.txt").write_text("".join(f"{i / 100} {i} 0 0 0 0 0 1\n" for i in range(60)))
    times = {"times": str(tmp_path / "times.txt")} if given else {}
    truth = Folder(make(tmp_path, poses=str(tmp_path / "poses.txt"), **times)).ground_truth()
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam[:, 0, 3], [10, 20, 30], atol=1e-9)


def test_a_frame_whose_pose_is_nan_has_no_ground_truth(tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" + "nan " * 12 + "\n1 0 0 2 0 1 0 0 0 0 1 0\n")
    folder = Folder(make(tmp_path, poses=str(tmp_path / "poses.txt")))
    truth = folder.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == [0, 2]
    assert folder.remarks == ("1 of 3 frames have no ground truth: frame 1",)
    tracker = GroundTruth(GroundTruthConfig(name="groundtruth"))
    tracker.start(folder)
    assert [tracker.track(folder.frame(i)).state for i in range(3)] == ["ok", "lost", "ok"]


def test_other_formats_are_counted(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "0.tif").touch()
    with pytest.raises(BenchError, match=r"holds no PNG or JPEG image, but 1 \.tif, the first 0\.tif\."):
        Folder(FolderConfig(left=str(tmp_path / "left"), fx=1.0, fy=1.0, cx=1.0, cy=1.0, baseline=1.0))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({}, None),
        ({"cx": 62.0, "cy": 23.0}, "seems to be of images about 1.9 times as large. Multiply fx, fy, cx, cy by what"),
        ({"cx": 42.0, "cy": 16.0}, "seems to be of images about 1.3 times as large"),
        ({"cx": 16.0, "cy": 6.0}, "seems to be of images about 0.5 times as large"),
        ({"cx": 12.5, "cy": 23.0}, "is far from the centre of the images of 64x24 pixels: width and height exchanged?"),
        ({"cx": 31.0, "cy": 19.0}, "cropped images, or of another camera"),
    ],
)
def test_a_principal_point_of_another_size_is_told(
    tmp_path: Path, settings: dict[str, float], words: str | None
) -> None:
    told = Folder(make(tmp_path, **settings)).to_tell()
    assert (told == ()) if words is None else (len(told) == 1 and words in told[0])
