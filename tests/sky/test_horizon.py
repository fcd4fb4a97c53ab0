"""Sky masks against CamVid's labels, the street's exact sky, and known places of KITTI images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.registry import PluginConfig, build
from bench.types import DepthMap, Image, Mask, StereoCamera
from plugins.datasets.kitti import Kitti, KittiConfig
from plugins.datasets.street import Street, StreetConfig
from plugins.sky.horizon import Horizon, HorizonConfig
from plugins.stereo.sgbm import Sgbm, SgbmConfig

CAMERA = StereoCamera(320, 120, 180.0, 180.0, 159.5, 59.5, (0.5, 0.0, 0.0))
LABEL_SKY, LABEL_NONE = 0, 11


def without_depth(image: Image) -> DepthMap:
    return DepthMap(np.full(image.shape[:2], np.nan, dtype=np.float32), "none")


def iou(found: Mask, truth: Mask) -> float:
    return (found & truth).sum() / (found | truth).sum()


def test_camvid(test_data: Path) -> None:
    both = either = 0
    for path in sorted((test_data / "camvid_sky" / "test").glob("*.png")):
        image = np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])
        label = cv2.imread(str(path.parents[1] / "testannot" / path.name), cv2.IMREAD_UNCHANGED)
        found = Horizon(HorizonConfig()).segment(image, without_depth(image), CAMERA)
        known = label != LABEL_NONE
        both += (found & (label == LABEL_SKY) & known).sum()
        either += ((found | (label == LABEL_SKY)) & known).sum()
    assert both / either > 0.86


@pytest.mark.parametrize("position", [0, 5])
def test_kitti_06_sky_and_white_house(kitti_root: Path, position: int) -> None:
    kitti = Kitti(KittiConfig(root=str(kitti_root), sequence="06"))
    frame = kitti.frame(position)
    sky = Horizon(HorizonConfig()).segment(
        frame.left, Sgbm(SgbmConfig()).depth(frame, position, kitti.camera), kitti.camera
    )
    # Looked up in the pictures: clear sky left of the scaffold, the white terrace on the right, everything below.
    assert sky[5:60, 540:640].mean() > 0.9
    assert sky[:, 1000:].mean() < 0.01
    assert not sky[180:].any()
    # The laser returns nothing from the sky.
    lidar = kitti.lidar_depth(position)
    assert lidar is not None
    assert sky[np.isfinite(lidar)].mean() < 0.01


@pytest.mark.parametrize(("seed", "position"), [(0, 3), (2, 8)])
def test_street(seed: int, position: int) -> None:
    street = Street(StreetConfig(frames=10, width=640, height=192, seed=seed))
    frame = street.frame(position)
    depth = Sgbm(SgbmConfig()).depth(frame, position, street.camera)
    found = Horizon(HorizonConfig()).segment(frame.left, depth, street.camera)
    assert iou(found, street.true_sky(position)) > 0.8


def picture_with_white_house() -> Image:
    """Grey ground, white sky, and a white house on the left whose wall reaches the top."""
    image = np.full((120, 320, 3), 90, dtype=np.uint8)
    image[:60] = 235
    image[:, :100] = 228
    image[:, 100:104] = 60
    return image


def test_stereo_tells_a_white_house_from_the_sky() -> None:
    image = picture_with_white_house()
    depth = without_depth(image)
    assert Horizon(HorizonConfig()).segment(image, depth, CAMERA)[:50, :90].mean() > 0.9
    depth.depth[:, :104] = 8.0
    found = Horizon(HorizonConfig()).segment(image, depth, CAMERA)
    assert found[:50, 120:].mean() > 0.99
    assert not found[:, :95].any()
    assert not found[65:].any()


def test_indoors_there_is_no_sky() -> None:
    image = np.random.default_rng(0).integers(0, 90, (120, 320, 3), dtype=np.uint8)
    assert not Horizon(HorizonConfig()).segment(image, without_depth(image), CAMERA).any()


def test_none_gives_none() -> None:
    image = picture_with_white_house()
    assert build(PluginConfig(name="none"), "sky").segment(image, without_depth(image), CAMERA) is None


def test_wrong_setting() -> None:
    with pytest.raises(BenchError, match="max_disparity=0 must be positive"):
        Horizon(HorizonConfig(max_disparity=0))
