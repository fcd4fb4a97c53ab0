"""The protocol's settings and their errors."""

from __future__ import annotations

import json

import pytest

from bench.errors import BenchError
from bench.protocol import Protocol


def test_held_out_frames_follow_the_remainder() -> None:
    protocol = Protocol(holdout_every=5)
    assert [number for number in range(10) if protocol.is_held_out(number)] == [2, 7]
    assert not any(Protocol().is_held_out(number) for number in range(10))


def test_the_stamp_says_how_and_has_no_path() -> None:
    stamp = Protocol(lpips_weights="/home/somebody/alex.npz", depth_max_m=80.0).stamp()
    assert stamp["depth_max_m"] == 80.0
    assert "somebody" not in json.dumps(stamp)
    assert Protocol(lpips=False).stamp()["lpips_net"] is None
    without_sky = Protocol(sky="out", right_view=False, depth_mask="unoccluded").stamp()
    assert without_sky["lpips_net"] is None
    assert "not sky" in without_sky["psnr"]
    assert "without a nearer return" in without_sky["depth_l1"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"alignment": "sim3"}, r"protocol\.alignment='sim3' is not one of se3, none\."),
        ({"rendered_depth": "normalised"}, r"Did you mean 'normalized'\?"),
        ({"ssim": "msssim"}, r"protocol\.ssim='msssim' is not one of skimage-gaussian, 3dgs, ms-ssim.*'ms-ssim'\?"),
        ({"depth_mask": "garg"}, r"protocol\.depth_mask='garg' is not one of all, unoccluded"),
        ({"sky": "no"}, r"protocol\.sky='no' is not one of in, out"),
        ({"sky": "out"}, r"protocol\.sky=out needs protocol\.right_view=false"),
        ({"sky": "out", "right_view": False, "ssim": "ms-ssim"}, r"sky=out can't go with protocol\.ssim=ms-ssim"),
        ({"holdout_every": 1}, r"protocol\.holdout_every=1 is no use"),
        ({"holdout_every": -2}, r"protocol\.holdout_every=-2 is no use"),
        ({"holdout_every": 2}, r"protocol\.holdout_remainder=2 must lie in 0\.\.1"),
        ({"depth_min_m": -1.0}, r"protocol\.depth_min_m=-1\.0 must not be negative"),
        ({"depth_max_m": 0.2}, r"protocol\.depth_max_m=0\.2 must be above protocol\.depth_min_m=0\.5"),
        ({"hold_out_every": 5}, r"protocol\.hold_out_every is no setting.*Did you mean 'holdout_every'\?"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Protocol.from_mapping(settings)
