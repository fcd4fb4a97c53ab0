"""Virtual KITTI 2 and TartanAir: axes, units, orders of columns by hand, and what is said of damaged folders."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from plugins.datasets.tartanair import TartanAir, TartanAirConfig
from plugins.datasets.vkitti2 import Vkitti2, Vkitti2Config
from tests.datasets.rendered_disk import (
    BASELINE,
    CENTRES,
    HEIGHT,
    LAYOUTS,
    RIGHT_TURN,
    V2,
    WIDTH,
    picture,
    save,
    write_tartanair,
    write_vkitti2,
)


def opened_vkitti2(folder: Path, **settings: Any) -> Vkitti2:
    return Vkitti2(Vkitti2Config(**{"root": str(folder), "sequence": "2", "variation": "rain", **settings}))


def expect_the_drive(dataset: Dataset) -> None:
    truth = dataset.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == [0, 1, 2]
    np.testing.assert_allclose(truth.T_world_cam[:, :3, 3], CENTRES, atol=1e-6)
    np.testing.assert_allclose(truth.T_world_cam[1, :3, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(truth.T_world_cam[2, :3, :3], RIGHT_TURN, atol=1e-6)
    # The path is as long as it is.
    assert np.linalg.norm(np.diff(truth.T_world_cam[:, :3, 3], axis=0), axis=1).sum() == pytest.approx(4.0, abs=1e-5)


def test_vkitti2(tmp_path: Path) -> None:
    write_vkitti2(tmp_path)
    dataset = opened_vkitti2(tmp_path)
    camera = dataset.camera
    assert (dataset.label, dataset.numbers, dataset.lacks()) == ("vkitti2/02/rain", (0, 1, 2), ())
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (37.5, 37.25, 31.5, 12.5)
    np.testing.assert_allclose(camera.right_position, (BASELINE, 0, 0), atol=1e-6)
    expect_the_drive(dataset)
    frame = dataset.frame(2)
    assert frame.timestamp == 0.2
    for side, image in enumerate(frame.pair("", "")):  # RGB of a JPEG
        assert np.abs(image.astype(int) - picture(2, side)[..., ::-1]).max() <= 4
    depth, sky, disparity = dataset.true_depth(1), dataset.true_sky(1), dataset.true_disparity(1)
    assert depth is not None
    assert sky is not None
    assert disparity is not None
    assert np.isnan(depth[:8]).all()
    assert (depth[8:] == np.float32(12.34)).all()
    assert (sky[:8].all(), sky[8:].any()) == (True, False)
    np.testing.assert_allclose(disparity[8:], 37.5 * BASELINE / 12.34, rtol=1e-5)
    np.testing.assert_array_equal(dataset.sensor_depth(1), depth)
    half = opened_vkitti2(tmp_path, scale=0.5, frames="1:3")
    small, sky = half.true_depth(0), half.true_sky(0)
    assert small is not None
    assert sky is not None
    assert small.shape == sky.shape == half.frame(0).left.shape[:2] == (12, 32)
    assert np.isnan(small).sum() == sky.sum() == 4 * 32
    assert [one.settings for one in Vkitti2.sequences_in(tmp_path)] == [{"sequence": "Scene02", "variation": "rain"}]


def test_columns_are_found_by_their_names(tmp_path: Path) -> None:
    """The same file with the columns turned round."""
    folder = write_vkitti2(tmp_path)
    lines = (folder / "extrinsic.txt").read_text().splitlines()
    turned = [" ".join(line.split()[::-1]) for line in lines]
    (folder / "extrinsic.txt").write_text("\n".join(turned) + "\n")
    expect_the_drive(opened_vkitti2(tmp_path))


def test_vkitti2_without_depth_and_classes(tmp_path: Path) -> None:
    folder = write_vkitti2(tmp_path)
    for name in ("depth", "classSegmentation"):
        (folder / "frames" / name).rename(folder / name)
    dataset = opened_vkitti2(tmp_path)
    assert dataset.lacks() == ("no depth", "no classSegmentation (for the sky)")
    assert (dataset.true_depth(0), dataset.true_sky(0), dataset.true_disparity(0)) == (None, None, None)


def opened_tartanair(root: Path, **settings: Any) -> TartanAir:
    return TartanAir(TartanAirConfig(**{"root": str(root), "sequence": "hospital/Easy/P001", **settings}))


@pytest.mark.parametrize("version", LAYOUTS)
def test_tartanair(version: str, tmp_path: Path) -> None:
    write_tartanair(tmp_path, version)
    dataset = opened_tartanair(tmp_path)
    camera = dataset.camera
    assert (dataset.label, dataset.numbers, dataset.lacks()) == ("tartanair/hospital/Easy/P001", (0, 1, 2), ())
    # 90 degrees wide, as 320 for 640 pixels.
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline) == (32.0, 32.0, 32.0, 12.0, 0.25)
    expect_the_drive(dataset)
    frame = dataset.frame(1)
    assert frame.timestamp == 0.1
    for side, image in enumerate(frame.pair("", "")):
        np.testing.assert_array_equal(image, picture(1, side)[..., ::-1])
    depth, disparity = dataset.true_depth(1), dataset.true_disparity(1)
    assert depth is not None
    assert disparity is not None
    assert np.isnan(depth[:8]).all()
    assert (depth[8:] == np.float32(12.34)).all()
    np.testing.assert_allclose(disparity[8:], 8 / 12.34, rtol=1e-6)  # 80 / depth at 640 pixels
    assert [one.settings for one in TartanAir.sequences_in(tmp_path)] == [{"sequence": "hospital/Easy/P001"}]
    half = opened_tartanair(tmp_path / "hospital/Easy/P001", sequence="", scale=0.5, frames="1:3")
    small = half.true_depth(0)
    assert small is not None
    assert small.shape == half.frame(0).left.shape[:2] == (12, 32)
    truth = half.ground_truth()
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam[1, :3, 3], [0, 0, 2], atol=1e-6)


def test_tartanair_without_depth_and_poses(tmp_path: Path) -> None:
    folder = write_tartanair(tmp_path)
    (folder / "depth_left").rename(folder / "gone")
    (folder / "pose_left.txt").unlink()
    dataset = opened_tartanair(tmp_path)
    assert dataset.lacks() == ("no depth", "no ground truth")
    assert (dataset.true_depth(0), dataset.ground_truth()) == (None, None)


Damage = Callable[[Path], object]


def edited(name: str, old: str, new: str) -> Damage:
    def damage(folder: Path) -> None:
        text, count = re.subn(old, new, (folder / name).read_text(), count=1, flags=re.MULTILINE)
        assert count == 1
        (folder / name).write_text(text)

    return damage


def without(name: str) -> Damage:
    return lambda folder: (folder / name).unlink()


def inverted(folder: Path) -> None:
    """Camera to world, as some take the file to be."""
    lines = (folder / "extrinsic.txt").read_text().splitlines()
    rows = [lines[0]]
    for line in lines[1:]:
        words = line.split()
        T = np.linalg.inv(np.array(words[2:], float).reshape(4, 4))
        rows.append(" ".join([*words[:2], *map(str, T.ravel())]))
    (folder / "extrinsic.txt").write_text("\n".join(rows) + "\n")


RGB, DEPTH = "frames/rgb", "frames/depth/Camera_0"
BAD_VKITTI2: dict[str, tuple[Damage | None, dict[str, Any], str]] = {
    "no root": (None, {"root": "gone"}, "dataset.root=gone: this folder does not exist"),
    "no scene": (None, {"sequence": "street"}, "sequence='street' is no scene"),
    "weather": (None, {"variation": "snow"}, r"snow/frames does not exist; .* holds Scene02 rain\. Choose"),
    "inverted": (inverted, {}, r"extrinsic\.txt, frame \d: camera 1 is not straight on the right of camera 0"),
    "header": (edited("extrinsic.txt", "t2", "z2"), {}, "the header names no column 't2'"),
    "cut": (edited("extrinsic.txt", r"(?s)\n2 1 .*", "\n"), {}, "has no numbers of frame 2, camera 1"),
    "text": (edited("extrinsic.txt", "^1 0 1", "1 0 one"), {}, r"extrinsic\.txt, line 4: no row of numbers"),
    "rotation": (edited("extrinsic.txt", "^1 0 1", "1 0 3"), {}, "frame 1 is no rotation"),
    "zoom": (edited("intrinsic.txt", "^1 1 37.5", "1 1 38"), {}, "the cameras differ"),
    "right": (without(f"{RGB}/Camera_1/rgb_00001.jpg"), {}, "Camera_1 lacks frame 1"),
    "left": (without(f"{RGB}/Camera_0/rgb_00002.jpg"), {}, "Camera_0 lacks frame 2, which Camera_1 has"),
    "depth": (without(f"{DEPTH}/depth_00001.png"), {}, "depth/Camera_0 lacks frame 1"),
}


NPY = "depth_left/000001_left_depth.npy"
BAD_TARTANAIR: dict[str, tuple[Damage | None, dict[str, Any], str]] = {
    "no sequence": (None, {"sequence": "P9"}, r"P9 holds no folder image_left or .* there are hospital/Easy/P001\."),
    "poses": (edited("pose_left.txt", r"(?s)\n.*", "\n"), {}, r"pose_left\.txt has 1 poses for 3 images"),
    "columns": (edited("pose_left.txt", "^5.0", "0.0 5.0"), {}, "line 1: found 8 values, expected 7 numbers"),
    "quaternion": (edited("pose_left.txt", "0 0 1 0", "0 0 2 0"), {}, "line 3: the quaternion has length 2"),
    "right": (without("image_right/000001_right.png"), {}, "image_right lacks frame 1"),
    "depth": (without(NPY), {}, r"000001_left_depth\.npy is missing"),
}


@pytest.mark.parametrize(
    ("write", "opened", "damage", "settings", "message"),
    [pytest.param(write_vkitti2, opened_vkitti2, *case, id=f"vkitti2 {name}") for name, case in BAD_VKITTI2.items()]
    + [
        pytest.param(write_tartanair, opened_tartanair, *case, id=f"tartanair {name}")
        for name, case in BAD_TARTANAIR.items()
    ],
)
def test_what_is_wrong_is_said(
    write: Callable[[Path], Path],
    opened: Callable[..., Dataset],
    damage: Damage | None,
    settings: dict[str, Any],
    message: str,
    tmp_path: Path,
) -> None:
    folder = write(tmp_path)
    if damage is not None:
        damage(folder)
    with pytest.raises(BenchError, match=message) as caught:
        opened(tmp_path, **settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("version", "content", "message"),
    [
        ("v1", np.zeros((3, 4), np.float32), r"holds float32 \(3, 4\), and the images are 64x24"),
        ("v1", np.zeros((HEIGHT, WIDTH)), r"holds float64 \(24, 64\)"),
        ("v1", np.array([None]), "can't be read as depth"),
        (
            "V2",
            np.zeros((HEIGHT, WIDTH), np.uint16),
            "can't be read as depth: it is no PNG of 64x24 pixels and four channels",
        ),
    ],
)
def test_damaged_depth_is_said(version: str, content: np.ndarray, message: str, tmp_path: Path) -> None:
    folder = write_tartanair(tmp_path, version)
    if version == V2:
        save(folder / "depth_lcam_front/000001_lcam_front_depth.png", content)
    else:
        np.save(folder / NPY, content, allow_pickle=True)
    with pytest.raises(BenchError, match=message):
        opened_tartanair(tmp_path).true_depth(1)
