"""AnyNet with the published KITTI weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stereo_pairs import end_point_error, kitti_2015_sample, shifted_pair

from bench.errors import BenchError
from plugins.stereo.anynet import AnyNetConfig, AnyNetStereo


@pytest.mark.slow
def test_kitti_2015(test_data: Path, weights_root: Path) -> None:
    """The authors' own network gives 1.02 px."""
    left, right, truth = kitti_2015_sample(test_data)
    network = AnyNetStereo(AnyNetConfig(device="cpu"))
    assert network.weights() == {"network": weights_root / "anynet" / "kitti2015.pth"}
    disparity = network.disparity(left, right)
    assert end_point_error(disparity, truth) == pytest.approx(1.02, abs=0.01)
    np.testing.assert_array_equal(network.disparity(left, right), disparity)


@pytest.mark.slow
def test_the_other_checkpoint(test_data: Path, weights_root: Path) -> None:
    left, right, truth = kitti_2015_sample(test_data)
    network = AnyNetStereo(AnyNetConfig(device="cpu", trained_on="kitti2012"))
    assert network.weights_path == weights_root / "anynet" / "kitti2012.pth"
    assert 1.02 < end_point_error(network.disparity(left, right), truth) < 1.5


@pytest.mark.slow
def test_strips_and_left_right_check(test_data: Path, weights_root: Path) -> None:
    left, right, truth = kitti_2015_sample(test_data)
    whole = AnyNetStereo(AnyNetConfig(device="cpu")).disparity(left, right)
    # Its receptive field is 200 rows and more, but what lies that far away counts little.
    tiled = AnyNetStereo(AnyNetConfig(device="cpu", tile_rows=192, tile_overlap=96)).disparity(left, right)
    assert np.nanmedian(np.abs(tiled - whole)) < 0.3
    assert end_point_error(tiled, truth) < 1.2
    checked = AnyNetStereo(AnyNetConfig(device="cpu", left_right_check_px=2.0)).disparity(left, right)
    kept = np.isfinite(checked) & np.isfinite(truth)
    assert 0.7 < kept.sum() / np.isfinite(truth).sum() < 0.99
    assert np.abs(checked - truth)[kept].mean() < 0.9


def test_odd_sizes(weights_root: Path) -> None:
    disparity = AnyNetStereo(AnyNetConfig(device="cpu")).disparity(*shifted_pair(67, 201, 20))
    assert (disparity.shape, disparity.dtype) == ((67, 201), np.float32)


def test_wrong_checkpoint_name() -> None:
    with pytest.raises(BenchError, match=r"stereo\.trained_on='kitti15' is not one of kitti2015, kitti2012\. Did you"):
        AnyNetStereo(AnyNetConfig(trained_on="kitti15"))
