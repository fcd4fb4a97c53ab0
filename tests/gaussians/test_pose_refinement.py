"""Corrections of poses: found from pictures, the first keyframe's none, even in between."""

from __future__ import annotations

import numpy as np
import torch

from bench.authoring.random_scenes import SceneSpec, random_scene
from bench.gaussians.pose_refinement import PoseRefinement
from bench.geometry import se3
from bench.registry import PluginConfig
from bench.types import PinholeView
from plugins.rasterizers.cpu import CpuRasterizer

OFF = np.array([0.02, -0.01, 0.015, 0.003, -0.002, 0.004])


def test_a_keyframe_finds_back_to_where_its_picture_was_taken() -> None:
    planes, view = random_scene(SceneSpec(1, 200, 96, 64, 3.0, (0.2, 0.9)))
    rasterizer = CpuRasterizer(PluginConfig("cpu"))
    image = rasterizer.render(planes, view, differentiable=False).color
    wrong, refinement = view.T_world_cam @ se3.exp(OFF), PoseRefinement(1e-3)
    refinement.add(0)
    refinement.add(5)
    for _ in range(60):
        T = refinement.corrected(5, wrong)
        at = PinholeView(T, view.fx, view.fy, view.cx, view.cy, view.width, view.height)
        rendered = rasterizer.render(planes, at)
        gradients = rasterizer.backward(rendered, rendered.color - image, None, None, pose=True)
        assert gradients.twist is not None
        refinement.step(0, gradients.twist)
        refinement.step(5, gradients.twist)
    np.testing.assert_array_equal(refinement.corrected(0, wrong), wrong)
    left_over = se3.log(se3.inverse(view.T_world_cam) @ refinement.corrected(5, wrong))
    assert np.linalg.norm(left_over[3:]) < 0.3 * np.linalg.norm(OFF[3:])
    assert np.linalg.norm(left_over[:3]) < 0.3 * np.linalg.norm(OFF[:3])


def test_frames_in_between_get_what_lies_in_between() -> None:
    refinement = PoseRefinement(1e-3)
    for number in (2, 6):
        refinement.add(number)
    C = se3.exp(OFF)
    state = refinement.state()
    state["corrections"][6] = torch.from_numpy(C)
    refinement.restore(state)
    T = se3.exp(np.array([4.0, 1, 2, 0.3, 0.2, 0.1]))
    for number, share in ((0, 0.0), (2, 0.0), (4, 0.5), (6, 1.0), (9, 1.0)):
        expected = T @ se3.inverse(se3.interpolate(np.eye(4), C, np.array(share)))
        np.testing.assert_allclose(refinement.corrected(number, T), expected, atol=1e-12)
    refinement.add(7)
    np.testing.assert_array_equal(refinement.state()["corrections"][7], C)
    assert PoseRefinement(0.0).corrected(4, T) is T
