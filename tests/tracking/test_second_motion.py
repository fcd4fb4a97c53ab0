"""Two rigid motions of made-up points, of which one was told to be the camera's."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from bench.geometry import se3
from bench.tracking.pose_optimization import Observations
from bench.tracking.second_motion import SecondMotion
from bench.types import StereoCamera

CAMERA = StereoCamera(640, 192, 370.0, 370.0, 320.0, 96.0, (0.5, 0.0, 0.0))
OURS, THEIRS = se3.exp([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]), se3.exp([0.0, 0.0, 0.9, 0.0, 0.01, 0.0])
"""T_cam_world after a frame: by the street the camera went ahead by 1 m, by the lorry back by 0.9 m."""


def test_the_motion_of_what_the_believed_one_leaves_is_found_and_remembered_for_a_while() -> None:
    rng = np.random.default_rng(0)
    position = rng.uniform((-6, -1.5, 8), (6, 1.5, 25), (160, 3))
    moved = np.where(np.arange(160) < 100, 0, 1)
    in_camera = np.stack([position @ T[:3, :3].T + T[:3, 3] for T in (OURS, THEIRS)])[moved, np.arange(160)]
    uv = in_camera[:, :2] / in_camera[:, 2:] * CAMERA.fx + (CAMERA.cx, CAMERA.cy)
    seen = Observations(uv, CAMERA.fx * CAMERA.baseline / in_camera[:, 2], np.ones(160))
    view: Any = SimpleNamespace(observations=seen.take)
    local_map: Any = SimpleNamespace(
        points=SimpleNamespace(position=position), keyframes=[SimpleNamespace(T_cam_world=np.eye(4))]
    )
    second, every = SecondMotion(CAMERA, local_map, 25), np.arange(160)
    assert not second.drives(THEIRS, OURS)
    found = second.find(view, (every, every), every[:100], OURS)
    assert found is not None
    np.testing.assert_allclose(found.T_cam_world, THEIRS, atol=1e-6)
    assert found.inliers.sum() > 50  # some far ahead agree with both
    near = se3.exp([0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert second.drives(near @ THEIRS, OURS)
    assert not second.drives(near @ OURS, OURS)
    for _ in range(5):
        assert second.expected
        second.fade()
    assert not second.expected
    assert not second.drives(THEIRS, OURS)
