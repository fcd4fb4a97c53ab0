"""The LiDAR variant hands on the data set's scan, and says so where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from bench.errors import BenchError
from bench.registry import PluginConfig, build
from bench.types import Map
from plugins.datasets.street import Street, StreetConfig


class WithoutSecondScan(Street):
    """A street whose LiDAR failed at position 1."""

    def lidar_depth(self, position: int) -> Map | None:  # type: ignore[override]
        return None if position == 1 else super().lidar_depth(position)


@pytest.mark.slow
def test_depth_is_the_scan_of_the_frame() -> None:
    street = Street(StreetConfig(frames=3, width=160, height=48))
    source = build(PluginConfig(name="lidar"), "stereo")
    source.start(street)
    depth = source.depth(street.frame(2), 2, street.camera)
    np.testing.assert_array_equal(depth.depth, street.lidar_depth(2))
    assert 0.05 < depth.known.mean() < 0.9


def test_missing_scan_is_an_error_with_a_way_out() -> None:
    street = WithoutSecondScan(StreetConfig(frames=3, width=160, height=48))
    source = build(PluginConfig(name="lidar"), "stereo")
    source.start(street)
    with pytest.raises(BenchError, match=r"street/0 has no LiDAR scan for frame 1\. .* stereo=sgbm"):
        source.depth(street.frame(1), 1, street.camera)
