"""The user's own pair: numbers in, frames out, and what can be wrong with the folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from kitti_disk import write_image

from bench.errors import BenchError
from plugins.datasets.folder import Folder, FolderConfig


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
    expect("dataset.baseline=nan must be positive", baseline=float("nan"))
    expect("outside the images of 64x24", cx=500.0)
    expect("dataset.left is not set", left="")
    expect("this folder does not exist", right=str(tmp_path / "gone"))
    expect("holds no PNG or JPEG", right=str(tmp_path))
    expect("frame 3 is missing .* frames 0 to 2", frames="0:5")
    expect("can't be read as text", poses=str(tmp_path / "gone.txt"))
    (tmp_path / "short.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    expect("has 1 poses, too few for image 2", poses=str(tmp_path / "short.txt"))
    write_image(tmp_path / "left" / "shot1.png", 0, height=20)
    with pytest.raises(BenchError, match=r"shot1.png is 64x20 pixels"):
        Folder(good)
    (tmp_path / "right" / "shot2.png").unlink()
    with pytest.raises(BenchError, match=r"has 3 images, but .* has 2"):
        Folder(good)


def test_truncated_jpeg(tmp_path: Path) -> None:
    config = make(tmp_path, suffix=".jpg")
    path = tmp_path / "left" / "shot2.jpg"
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(BenchError, match=r"shot2.jpg is truncated"):
        Folder(config)
