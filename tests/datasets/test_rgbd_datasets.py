"""TUM's and Replica's layouts, made up on the disk, and what is said of damaged ones."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.contracts.saved_run import SavedRun, SavedView
from bench.errors import BenchError
from bench.protocol import Protocol
from bench.registry import PluginConfig, lookup
from plugins.datasets.tum_rgbd import associate
from plugins.evaluators.depth_l1 import DepthL1Evaluator
from tests.datasets.rgbd_disk import COLOR, HEIGHT, OWN, STORED, WIDTH, replica, tum, write


def opened(name: str, folder: Path, **settings: Any) -> Dataset:
    sequence = {"tum_rgbd": "rgbd_dataset_handheld", "replica": "office7"}[name]
    plugin = lookup("dataset", name)
    dataset: Dataset = plugin.cls(plugin.config(**{"root": str(folder), "sequence": sequence, **OWN, **settings}))
    return dataset


def test_tum_joins_colour_depth_and_poses_by_time(tmp_path: Path) -> None:
    tum(tmp_path)
    dataset = opened("tum_rgbd", tmp_path)
    assert (dataset.label, dataset.numbers, dataset.has_right) == ("tum/handheld", (0, 1), False)
    assert dataset.remarks == ("1 of 3 colour images have no depth image within 0.02 s: left out",)
    for position, (k, time) in enumerate([(0, 10.0), (2, 10.2)]):
        frame, depth = dataset.frame(position), dataset.sensor_depth(position)
        assert (frame.timestamp, frame.right) == (time, None)
        np.testing.assert_array_equal(frame.left, COLOR[k])
        assert depth is not None
        assert np.isnan(depth[2, 3])
        np.testing.assert_allclose(depth[STORED[k] > 0], STORED[k][STORED[k] > 0] / 5000, rtol=1e-6)
    truth = dataset.ground_truth()
    assert truth is not None
    # Before its first pose the nearest one counts; at 10.2 s, between two, the place between them.
    np.testing.assert_allclose(truth.T_world_cam[:, 0, 3], [0.005, 0.2], atol=1e-9)


def test_replica_has_numbered_images_and_a_line_of_sixteen_numbers_each(tmp_path: Path) -> None:
    replica(tmp_path)
    dataset = opened("replica", tmp_path, frames="1:3")
    assert (dataset.label, dataset.numbers, dataset.has_right) == ("replica/office7", (1, 2), False)
    depth, truth = dataset.sensor_depth(0), dataset.ground_truth()
    assert depth is not None
    np.testing.assert_allclose(depth[STORED[1] > 0], STORED[1][STORED[1] > 0] / 6553.5, rtol=1e-6)
    assert truth is not None
    assert truth.T_world_cam[:, :3, 3].tolist() == [[1, 0, 0.5], [2, 0, 0.5]]
    assert np.abs(dataset.frame(0).left.astype(int) - COLOR[1]).mean() < 60  # a JPEG of noise


def test_nearest_times_are_joined_first_and_each_image_once() -> None:
    rows, partners = associate(np.array([0.0, 0.01, 0.05]), np.array([0.012, 0.055, 0.1]))
    assert (rows.tolist(), partners.tolist()) == ([1, 2], [0, 1])


@pytest.mark.parametrize("name", ["tum_rgbd", "replica"])
def test_half_size_halves_the_camera_and_mixes_no_depths(name: str, tmp_path: Path) -> None:
    {"tum_rgbd": tum, "replica": replica}[name](tmp_path)
    whole, half = opened(name, tmp_path), opened(name, tmp_path, scale=0.5)
    camera = half.camera
    assert (camera.width, camera.height, camera.fx, camera.fy) == (WIDTH // 2, HEIGHT // 2, 10.0, 10.5)
    assert (camera.cx, camera.cy) == (3.5, 2.25)  # the middle of the left upper pixel moves from 0 to -0.25
    depth, of_whole = half.sensor_depth(0), whole.sensor_depth(0)
    assert depth is not None
    assert of_whole is not None
    assert set(depth[np.isfinite(depth)].tolist()) <= set(of_whole[np.isfinite(of_whole)].tolist())
    assert half.frame(0).left.shape == (HEIGHT // 2, WIDTH // 2, 3)


@pytest.mark.parametrize(
    ("name", "fx", "k1"), [("freiburg1_desk", 517.3, 0.2624), ("freiburg2_xyz", 520.9, 0.2312), ("fr3_x", 535.4, None)]
)
def test_tums_cameras_are_known_by_the_name_of_the_folder(
    name: str, fx: float, k1: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Colour is straightened by the published coefficients, unless that is switched off; depth never is."""
    tum(tmp_path).rename(tmp_path / name)
    unset = dict.fromkeys(OWN, 0.0)
    with pytest.raises(BenchError, match="is 16x12 pixels, and the published camera is of 640x480"):
        opened("tum_rgbd", tmp_path, sequence=name, **unset)
    for file in (tmp_path / name).glob("*/*.png"):
        write(file, cv2.resize(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), (640, 480)))
    used: list[np.ndarray] = []
    monkeypatch.setattr(cv2, "undistort", lambda image, K, distortion: used.append(distortion) or image)
    dataset = opened("tum_rgbd", tmp_path, sequence=name, **unset)
    assert dataset.camera.fx == fx
    dataset.frame(0)
    assert [distortion[0] for distortion in used] == ([k1] if k1 else [])
    opened("tum_rgbd", tmp_path, sequence=name, distortion=[], **unset).frame(0)
    assert len(used) == (1 if k1 else 0)


def test_a_wrong_factor_is_doubted(tmp_path: Path) -> None:
    tum(tmp_path)
    for factor in (5.0, 5e6):
        remarks = opened("tum_rgbd", tmp_path, depth_factor=factor).remarks
        assert any(f"is dataset.depth_factor={factor:g} right?" in remark for remark in remarks)


def _without(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def _with(name: str, text: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(text) and None


def _resized(name: str) -> Callable[[Path], None]:
    return lambda folder: write(folder / name, STORED[0][:6, :8])


@pytest.mark.parametrize(
    ("name", "damage", "settings", "message"),
    [
        ("tum_rgbd", _without("rgb.txt"), {}, r"rgbd_dataset_handheld holds no rgb\.txt.* Check dataset\.root"),
        ("tum_rgbd", _without("depth.txt"), {}, r"The list of images .*depth\.txt does not exist"),
        ("tum_rgbd", _without("depth/10.015.png"), {}, r"10\.015\.png is missing"),
        ("tum_rgbd", _with("rgb.txt", "10.0 ../../secret.png\n"), {}, r"rgb\.txt, line 1: expected a time in"),
        ("tum_rgbd", _with("rgb.txt", "2 rgb/10.000.png\n1 rgb/10.100.png\n"), {}, r"10\.100\.png is not after"),
        ("tum_rgbd", _with("rgb.txt", "99 rgb/10.000.png\n"), {}, r"no image of rgb\.txt \(99\.000 .* within 0\.02 s"),
        ("tum_rgbd", _with("groundtruth.txt", "99 0 0 0 0 0 0 1\n"), {}, r"nowhere near the images'"),
        ("tum_rgbd", _resized("depth/10.015.png"), {"frames": "0:1"}, r"is 8x6 pixels, and the colour .* is 16x12"),
        ("tum_rgbd", None, dict.fromkeys(OWN, 0.0), r"tells none of TUM's cameras \(freiburg1, .* dataset\.fx=\.\.\."),
        ("tum_rgbd", None, {"cy": 0.0}, r"Of dataset\.fx, fy, cx, cy only fx, fy, cx is set"),
        ("tum_rgbd", None, {"sequence": ""}, r"Choose dataset\.sequence=rgbd_dataset_handheld"),
        ("tum_rgbd", None, {"distortion": [0.1]}, r"dataset\.distortion=\[0\.1\] must be \[k1, k2, p1, p2, k3\]"),
        ("tum_rgbd", None, {"root": ""}, r"/tum_rgbd: this folder does not exist.* `bgs-bench data get tum_rgbd`"),
        ("tum_rgbd", None, {"scale": 2.0}, r"dataset\.scale=2\.0 must lie between"),
        ("replica", _without("results/depth000001.png"), {}, r"depth000001\.png is missing"),
        ("replica", _with("traj.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n"), {}, r"found 12 values, expected 16 numbers"),
        ("replica", _with("traj.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n"), {}, r"has 1 poses, too few for frame 2"),
        ("replica", None, {"sequence": "room9"}, r"there are these rooms: office7"),
        ("replica", None, dict.fromkeys(OWN, 0.0), r"is 16x12 pixels, and the published camera is of 1200x680"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_a_sentence(
    name: str, damage: Callable[[Path], None] | None, settings: dict[str, Any], message: str, tmp_path: Path
) -> None:
    folder = {"tum_rgbd": tum, "replica": replica}[name](tmp_path)
    if damage is not None:
        damage(folder)
    with pytest.raises(BenchError, match=message) as failure:
        opened(name, tmp_path, **settings)
    assert not re.search(r"\n", str(failure.value))


def test_depth_of_eight_bits_is_refused_when_it_is_read(tmp_path: Path) -> None:
    folder = tum(tmp_path)
    write(folder / "depth" / "10.190.png", (STORED[0] >> 8).astype(np.uint8))
    with pytest.raises(BenchError, match=r"10\.190\.png is no 16-bit PNG of 16x12 pixels"):
        opened("tum_rgbd", tmp_path).sensor_depth(1)


def test_frames_without_ground_truth_are_counted(tmp_path: Path) -> None:
    folder = tum(tmp_path)
    (folder / "groundtruth.txt").write_text("10.0 0 0 0 0 0 0 1\n")
    dataset = opened("tum_rgbd", tmp_path)
    truth = dataset.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == [0]
    assert dataset.remarks[-1] == "1 of 2 frames have no ground truth at their time"
    (folder / "groundtruth.txt").unlink()
    assert opened("tum_rgbd", tmp_path).ground_truth() is None


def test_depth_l1_is_scored_against_sensor_depth_where_there_is_no_lidar(tmp_path: Path) -> None:
    """A map rendered 7 cm too far everywhere; also nearer edges count, since no scanner stands above the camera."""
    replica(tmp_path)
    dataset = opened("replica", tmp_path)
    depth = dataset.sensor_depth(1)
    assert depth is not None
    run = SimpleNamespace(protocol=Protocol(depth_mask="unoccluded"))
    view = SimpleNamespace(lidar=None, sensor_depth=depth, depth=depth + np.float32(0.07))
    evaluator = DepthL1Evaluator(PluginConfig())
    evaluator.start(cast(SavedRun, run))
    assert evaluator.view(cast(SavedView, view)) == {
        "depth_l1_cm": pytest.approx(7.0, abs=1e-4),
        "depth_pixels": int((depth > Protocol().depth_min_m).sum()),
    }
