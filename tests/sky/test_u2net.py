"""The real sky network against CamVid's labels and known places of KITTI images, and how wrong files are refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from small_onnx import write_classifier

from bench.errors import BenchError
from bench.registry import build
from bench.types import DepthMap, Image, StereoCamera
from plugins.datasets.kitti import Kitti, KittiConfig
from plugins.sky.u2net import U2net, U2netConfig
from plugins.stereo.sgbm import Sgbm, SgbmConfig

CAMERA = StereoCamera(64, 48, 50.0, 50.0, 31.5, 23.5, (0.5, 0.0, 0.0))
LABEL_SKY, LABEL_NONE = 0, 11


def without_depth(image: Image) -> DepthMap:
    return DepthMap(np.full(image.shape[:2], np.nan, dtype=np.float32), "none")


@pytest.fixture(scope="module")
def u2net(weights_root: Path) -> U2net:
    return U2net(U2netConfig(weights=str(weights_root / "u2netp_sky" / "skyseg_u2netp_384.onnx")))


@pytest.mark.slow
def test_camvid(test_data: Path, u2net: U2net) -> None:
    """IoU over the pixels of all ten images (one has no sky), which the network's users measured as 0.897."""
    both = either = 0
    for path in sorted((test_data / "camvid_sky" / "test").glob("*.png")):
        image = np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])
        label = cv2.imread(str(path.parents[1] / "testannot" / path.name), cv2.IMREAD_UNCHANGED)
        found = u2net.segment(image, without_depth(image), CAMERA)
        known = label != LABEL_NONE
        both += (found & (label == LABEL_SKY) & known).sum()
        either += ((found | (label == LABEL_SKY)) & known).sum()
    assert both / either >= 0.89


@pytest.mark.parametrize("position", [0, 9])
def test_kitti_06_sky_and_white_house(kitti_root: Path, u2net: U2net, position: int) -> None:
    kitti = Kitti(KittiConfig(root=str(kitti_root), sequence="06"))
    frame = kitti.frame(position)
    depth = Sgbm(SgbmConfig()).depth(frame, position, kitti.camera)
    sky = u2net.segment(frame.left, depth, kitti.camera)
    # Looked up in the pictures: clear sky left of the scaffold, the white terrace on the right, everything below.
    assert sky[5:60, 540:640].mean() > 0.95
    assert sky[:, 1000:].mean() < 0.02
    assert not sky[180:].any()
    # The laser returns nothing from the sky.
    lidar = kitti.lidar_depth(position)
    assert lidar is not None
    assert sky[np.isfinite(lidar)].mean() < 0.01
    # Without stereo the network takes the terrace for sky.
    assert u2net.segment(frame.left, without_depth(frame.left), kitti.camera)[:, 1000:].mean() > 0.1


def test_same_bits_twice_and_names_its_file(weights_root: Path, u2net: U2net) -> None:
    image = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    first = u2net.segment(image, without_depth(image), CAMERA)
    assert first.shape == (48, 64)
    assert first.dtype == np.bool_
    assert np.array_equal(first, u2net.segment(image, without_depth(image), CAMERA))
    assert u2net.weights() == {"sky": weights_root / "u2netp_sky" / "skyseg_u2netp_384.onnx"}


def test_it_is_found_by_its_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "u2netp_sky").mkdir()
    file = write_classifier(tmp_path / "u2netp_sky" / "skyseg_u2netp_384.onnx", np.array([[0.0, 0.0, 1.0]]), 1)
    monkeypatch.setenv("BGS_WEIGHTS", str(tmp_path))
    network = build(U2netConfig(name="u2net"), "sky")
    assert network.weights() == {"sky": file}


def test_probability_above_the_threshold_is_sky(tmp_path: Path) -> None:
    """One map that is the normalised blue, (blue / 255 - 0.406) / 0.225, of a picture that grows bluer to the right."""
    file = write_classifier(tmp_path / "blue.onnx", np.array([[0.0, 0.0, 1.0]]), 1, size=(48, 64))
    image = np.zeros((48, 64, 3), dtype=np.uint8)
    image[..., 2] = np.arange(64, dtype=np.uint8) * 4
    found = U2net(U2netConfig(weights=str(file), threshold=0.75)).segment(image, without_depth(image), CAMERA)
    # 0.75 * 0.225 + 0.406 = 0.57475 of 255 is 146.56: columns from 37 on, whose blue is 148.
    assert np.array_equal(found.any(axis=0), np.arange(64) >= 37)
    assert np.array_equal(found.all(axis=0), np.arange(64) >= 37)


def test_wrong_files_and_settings(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"sky.weights: there is no file .*none.onnx. Give the path of an ONNX file"):
        U2net(U2netConfig(weights=str(tmp_path / "none.onnx")))
    (tmp_path / "text.onnx").write_text("this is no network")
    with pytest.raises(BenchError, match=r"text.onnx can't be loaded as an ONNX network \(.*\). Copy or export it"):
        U2net(U2netConfig(weights=str(tmp_path / "text.onnx")))
    several = write_classifier(tmp_path / "several.onnx", np.eye(3), 4)
    image = np.zeros((48, 64, 3), dtype=np.uint8)
    with pytest.raises(BenchError, match=r"several.onnx returns 3 maps; sky=u2net needs one.*choose sky=segformer"):
        U2net(U2netConfig(weights=str(several))).segment(image, without_depth(image), CAMERA)
    with pytest.raises(BenchError, match=r"sky.threshold=50.0 is no probability between 0 and 1"):
        U2net(U2netConfig(weights=str(several), threshold=50.0))
