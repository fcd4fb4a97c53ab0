"""PSMNet with the published KITTI 2015 weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from stereo_pairs import end_point_error, kitti_2015_sample, shifted_pair

from bench.errors import BenchError
from bench.stereo.network import NetworkConfig
from bench.stereo.networks.psmnet import PsmNet
from bench.weights import locate
from plugins.stereo.psmnet import PsmNetStereo


@pytest.fixture(scope="module")
def network() -> PsmNetStereo:
    if locate("psmnet_kitti2015") is None:
        pytest.skip("no PSMNet weights; get them with `bgs-bench weights get psmnet_kitti2015`")
    return PsmNetStereo(NetworkConfig(device="cpu"))


@pytest.mark.slow
def test_kitti_2015(network: PsmNetStereo, test_data: Path) -> None:
    """The checkpoint was trained on this image; another implementation gave 0.27 px."""
    left, right, truth = kitti_2015_sample(test_data)
    assert end_point_error(network.disparity(left, right), truth) == pytest.approx(0.27, abs=0.01)


@pytest.mark.slow
def test_part_of_kitti_2015(network: PsmNetStereo, test_data: Path) -> None:
    left, right, truth = kitti_2015_sample(test_data)
    part = (slice(180, 308), slice(400, 912))
    # Of the pooled context little is left, and what lies left of the part can't be matched.
    assert end_point_error(network.disparity(left[part], right[part])[:, 64:], truth[part][:, 64:]) < 0.6


@pytest.mark.slow
@pytest.mark.parametrize("shift", [9, 30])
def test_finds_a_known_shift_at_odd_sizes(network: PsmNetStereo, shift: int) -> None:
    pair = shifted_pair(37, 141, shift)
    disparity = network.disparity(*pair)
    assert (disparity.shape, disparity.dtype) == ((37, 141), np.float32)
    assert np.median(disparity[:, shift + 8 :]) == pytest.approx(shift, abs=1.0)
    np.testing.assert_array_equal(network.disparity(*pair), disparity)


@pytest.mark.slow
def test_fewer_bits_cost_little(network: PsmNetStereo) -> None:
    reduced = PsmNetStereo(NetworkConfig(device="cpu", dtype="bfloat16"))
    pair = shifted_pair(32, 128, 20)
    difference = np.abs(reduced.disparity(*pair) - network.disparity(*pair))[:, 28:]
    assert np.median(difference) < 0.2


def test_a_checkpoint_of_another_network(tmp_path: Path) -> None:
    state = PsmNet().state_dict()
    del state["dres2.conv6.0.weight"]
    file = tmp_path / "net.tar"
    torch.save({"state_dict": {f"module.{key}": value for key, value in state.items()}}, file)
    with pytest.raises(
        BenchError, match=r"net\.tar does not fit PsmNet: .* 1 missing \(dres2\.conv6\.0\.weight\)\. Is it"
    ):
        PsmNetStereo(NetworkConfig(device="cpu", weights=str(file)))
