"""The ground's plane is found under objects, wrong matches and holes, and not where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from bench.geometry.ground import ground_inverse_depth
from bench.types import Map, PinholeView

W, H = 200, 120
VIEW = PinholeView(np.eye(4), 150.0, 150.0, 99.5, 49.5, W, H)
X, Y = np.meshgrid((np.arange(W) - 99.5) / 150.0, (np.arange(H) - 49.5) / 150.0)


def road(roll: float, pitch: float, height: float) -> Map:
    """Inverse depth of a plane ``height`` metres below a camera that is rolled and pitched by small angles (rad)."""
    normal = np.array([np.sin(roll), np.cos(roll) * np.cos(pitch), np.sin(pitch)])
    return np.asarray((normal[0] * X + normal[1] * Y + normal[2]) / height, np.float32)


@pytest.mark.parametrize(("roll", "pitch", "height"), [(0.0, 0.0, 1.65), (0.05, -0.03, 1.65), (-0.04, 0.06, 0.4)])
def test_the_plane_under_a_car_a_wall_and_noise(roll: float, pitch: float, height: float) -> None:
    random = np.random.default_rng(1)
    truth = road(roll, pitch, height)
    inverse = np.maximum(truth, 1 / 60) * (1 + 0.01 * random.standard_normal(truth.shape))
    inverse[60:100, 20:60] = 0.5 / height  # a car
    inverse[70:90, 150:190] = 0.002  # matched wrongly, far below the road
    inverse[random.random(truth.shape) < 0.3] = np.nan
    found = ground_inverse_depth((1 / inverse).astype(np.float32), VIEW)
    assert found is not None
    below = truth > 0.05
    np.testing.assert_allclose(found[below], truth[below], rtol=0.03)


@pytest.mark.parametrize("depth", [np.full((H, W), 8.0), 6 / (1 + X), np.full((H, W), np.nan)])
def test_walls_and_nothing_are_no_ground(depth: Map) -> None:
    assert ground_inverse_depth(depth.astype(np.float32), VIEW) is None
