"""Principal points as data sets publish them go with their images; those of resized and turned images don't."""

from __future__ import annotations

import pytest

from bench.geometry.principal_point import doubt_about_size
from bench.types import StereoCamera

# Width, height, cx, cy.
PUBLISHED = {
    "KITTI 00": (1241, 376, 607.1928, 185.2157),
    "KITTI 03": (1242, 375, 609.5593, 172.854),
    "KITTI 06": (1226, 370, 601.8873, 183.1104),
    "KITTI-360": (1408, 376, 682.0495, 238.7695),
    "EuRoC": (752, 480, 367.215, 248.375),
    "TUM RGB-D fr1": (640, 480, 318.6, 255.3),
    "TartanAir": (640, 480, 320.0, 240.0),
}


def told(width: float, height: float, cx: float, cy: float) -> str | None:
    return doubt_about_size(StereoCamera(round(width), round(height), 700.0, 700.0, cx, cy, (0.5, 0.0, 0.0)))


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_cameras(name: str) -> None:
    width, height, cx, cy = PUBLISHED[name]
    assert told(width, height, cx, cy) is None
    for factor in (0.25, 0.5, 2 / 3, 1.5, 2.0):
        text = told(factor * width, factor * height, cx, cy)
        assert text is not None, factor
        assert f"({cx:g}, {cy:g}) is far from the centre" in text
    turned = told(height, width, cx, cy)
    assert turned is not None or max(width, height) < 1.5 * min(width, height)
