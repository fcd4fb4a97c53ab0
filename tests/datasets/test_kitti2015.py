"""KITTI Stereo 2015: the real sample read by another library, and a made-up folder that is damaged on purpose."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage.io

from bench.errors import BenchError
from plugins.datasets.kitti2015 import Kitti2015, Kitti2015Config
from plugins.datasets.street import Street, StreetConfig

SIZES = {3: (64, 24), 7: (60, 20)}
CALIBRATION = """calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_rect_02: 1.242000e+03 3.750000e+02
P_rect_02: 100 0 30 4.5 0 100 11 0.2 0 0 1 0.003
P_rect_03: 100 0 30 -49.5 0 100 11 0.1 0 0 1 0.001
"""


def write_png(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Pairs 3 and 7 of different size, below ``training`` as the archive has them; the later moment (_11) lies there,
    too."""
    training = tmp_path / "training"
    rng = np.random.default_rng(0)
    for number, (width, height) in SIZES.items():
        for side in ("image_2", "image_3"):
            for moment in (10, 11):
                pixels = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
                write_png(training / side / f"{number:06d}_{moment}.png", pixels)
        stored = np.zeros((height, width), dtype=np.uint16)
        stored[2, 5], stored[3, 6] = 256, 12345
        for folder, last in (("disp_occ_0", 40 * 256), ("disp_noc_0", 0)):
            stored[4, 7] = last
            write_png(training / folder / f"{number:06d}_10.png", stored)
        (training / "calib_cam_to_cam").mkdir(exist_ok=True)
        (training / "calib_cam_to_cam" / f"{number:06d}.txt").write_text(CALIBRATION)
    return tmp_path


def test_the_real_sample(test_data: Path) -> None:
    folder = test_data / "kitti2015_sample"
    dataset = Kitti2015(Kitti2015Config(root=str(folder)))
    assert (dataset.numbers, dataset.is_sequence) == ((46,), False)
    frame = dataset.frame(0)
    for image, side in ((frame.left, "image_2"), (frame.right, "image_3")):
        assert np.array_equal(image, skimage.io.imread(folder / side / "000046_10.png"))
    stored = skimage.io.imread(folder / "disp_occ_0" / "000046_10.png").astype(np.float64)
    disparity = dataset.true_disparity(0)
    assert disparity is not None
    assert disparity.dtype == np.float32
    assert np.array_equal(np.isnan(disparity), stored == 0)
    assert np.array_equal(disparity[stored > 0], (stored / 256)[stored > 0])
    # Of a car's laser: nothing is nearer than 2 m or so, 721.5 * 0.5327 / 2 = 192 px.
    assert 1 < np.nanmin(disparity) < np.nanmax(disparity) < 192
    assert (dataset.camera.width, dataset.camera.height) == (stored.shape[1], stored.shape[0])
    assert dataset.camera.fx * dataset.camera.baseline == pytest.approx(721.5377 * 0.5327)
    assert dataset.ground_truth() is None


def test_pairs_have_sizes_and_cameras_of_their_own(root: Path) -> None:
    dataset = Kitti2015(Kitti2015Config(root=str(root)))
    assert dataset.numbers == (3, 7)
    for position, (width, height) in enumerate(SIZES.values()):
        camera = dataset.camera_of(position)
        assert (camera.width, camera.height) == (width, height)
        assert dataset.frame(position).left.shape == (height, width, 3)
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (100, 100, 30, 11)
        # inv(K) (p2 - p3), p2 - p3 = (54, 0.1, 0.002): z = 0.002, y = (0.1 - 11 z) / 100, x = (54 - 30 z) / 100.
        assert camera.right_position == pytest.approx((0.5394, 0.00078, 0.002), abs=1e-12)
    assert dataset.frame(1).number == 7


def test_disparities_of_all_pixels_and_of_those_that_both_images_see(root: Path) -> None:
    for which, third in (("occ", 40.0), ("noc", np.nan)):
        disparity = Kitti2015(Kitti2015Config(root=str(root), disparity=which)).true_disparity(0)
        assert disparity is not None
        assert (disparity[2, 5], disparity[3, 6]) == (1.0, np.float32(12345 / 256))
        assert np.array_equal(disparity[4, 7], np.float32(third), equal_nan=True)
        assert np.isfinite(disparity).sum() == (3 if third == 40.0 else 2)


def test_some_of_the_pairs(root: Path) -> None:
    assert Kitti2015(Kitti2015Config(root=str(root / "training"), frames="4:10")).numbers == (7,)
    with pytest.raises(BenchError, match=r"dataset.frames=8:10: .*image_2 holds frames 3, 7. Choose a range"):
        Kitti2015(Kitti2015Config(root=str(root), frames="8:10"))


def test_the_testing_part_has_no_truth(root: Path) -> None:
    for folder in ("disp_occ_0", "disp_noc_0"):
        (root / "training" / folder).rename(root / folder)
    assert Kitti2015(Kitti2015Config(root=str(root))).true_disparity(0) is None


def test_damage_is_named(root: Path) -> None:
    training = root / "training"
    write_png(training / "disp_occ_0" / "000003_10.png", np.zeros((24, 64), dtype=np.uint8))
    with pytest.raises(BenchError, match=r"000003_10.png is no 16-bit PNG of 64x24 pixels"):
        Kitti2015(Kitti2015Config(root=str(root))).true_disparity(0)
    (training / "disp_occ_0" / "000007_10.png").unlink()
    with pytest.raises(BenchError, match=r"000007_10.png is missing. Restore it, or move disp_occ_0 away"):
        Kitti2015(Kitti2015Config(root=str(root)))
    calibration = training / "calib_cam_to_cam" / "000003.txt"
    calibration.write_text(CALIBRATION.replace("-49.5", "49.5"))
    with pytest.raises(BenchError, match=r"000003.txt: the baseline is -0.45.* m, and must be positive"):
        Kitti2015(Kitti2015Config(root=str(root), frames="3:4"))
    calibration.write_text(CALIBRATION.replace("0.003", "x"))
    with pytest.raises(BenchError, match=r"000003.txt, line 4: 'x' is not a number"):
        Kitti2015(Kitti2015Config(root=str(root), frames="3:4"))
    calibration.write_text("P_rect_02: 100 0 30 4.5 0 100 11 0.2 0 0 1 0.003\n")
    with pytest.raises(BenchError, match=r"000003.txt lacks P_rect_02 or P_rect_03"):
        Kitti2015(Kitti2015Config(root=str(root), frames="3:4"))
    write_png(training / "image_3" / "000003_10.png", np.zeros((24, 62, 3), dtype=np.uint8))
    with pytest.raises(BenchError, match=r"000003_10.png differ in size"):
        Kitti2015(Kitti2015Config(root=str(root)))


def test_wrong_roots(root: Path, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"no_data_here/kitti2015: this folder does not exist"):
        Kitti2015(Kitti2015Config())
    with pytest.raises(BenchError, match=r"holds no image_2, nor does a folder training in it"):
        Kitti2015(Kitti2015Config(root=str(root / "training" / "image_2")))
    with pytest.raises(BenchError, match=r"dataset.disparity='all' is not one of occ, noc"):
        Kitti2015(Kitti2015Config(root=str(root), disparity="all"))
    (root / "training" / "image_3").rename(root / "elsewhere")
    with pytest.raises(BenchError, match=r"training holds image_2, but no image_3"):
        Kitti2015(Kitti2015Config(root=str(root)))


def test_true_disparity_of_a_data_set_that_knows_its_depth() -> None:
    """A pixel back-projected, seen from the right camera, in float64: it lies the disparity further left."""
    street = Street(StreetConfig(frames=1, width=160, height=64))
    disparity, depth, camera = street.true_disparity(0), street.true_depth(0), street.camera
    assert disparity is not None
    assert disparity.dtype == np.float32
    assert np.array_equal(np.isnan(disparity), np.isnan(depth))
    v, u = np.nonzero(np.isfinite(depth))
    z = depth[v, u].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z, np.ones_like(z)])
    x, _, z_right = (np.linalg.inv(camera.T_left_right) @ points)[:3]
    seen_at = camera.fx * x / z_right + camera.cx
    np.testing.assert_allclose(u - seen_at, disparity[v, u], rtol=1e-5)
