"""Forward warping and the camera's motion between two frames, against hand-worked cases and true poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from bench import registry
from bench.stereo.upstream.motion import motion_between, size_of
from bench.stereo.upstream.splatting import splat_sum
from bench.stereo.upstream.temporal import _camera_of
from bench.types import StereoCamera


def test_splat_by_hand() -> None:
    """One pixel of value 8 moves by (0.25, 0.5); one leaves the image; one moves by a number that is none."""
    values = torch.zeros(1, 1, 3, 3)
    values[0, 0, 1, 1], values[0, 0, 0, 0], values[0, 0, 2, 0] = 8.0, 5.0, 7.0
    flow = torch.zeros(1, 2, 3, 3)
    flow[0, :, 1, 1] = torch.tensor([0.25, 0.5])
    flow[0, :, 0, 0] = torch.tensor([-1e9, 0.0])
    flow[0, :, 2, 0] = torch.tensor([float("nan"), 0.0])
    expected = [[0, 0, 0], [0, 3, 1], [0, 3, 1]]
    assert splat_sum(values, flow)[0, 0].tolist() == expected


def test_splat_at_the_border_keeps_what_stays_inside() -> None:
    values = torch.full((1, 2, 2, 2), 4.0)
    flow = torch.zeros(1, 2, 2, 2)
    flow[0, 0] = 1.5
    # Columns 0 and 1 go to 1.5 and 2.5: half of the first stays, in column 1.
    assert splat_sum(values, flow)[0].tolist() == [[[0, 2], [0, 2]]] * 2


def test_splat_keeps_the_sum_and_is_the_gradient_of_sampling() -> None:
    """Independent truth: summation splatting is the adjoint of bilinear sampling, which torch's autograd knows."""
    rng = torch.Generator().manual_seed(0)
    values, other = (torch.rand(2, 3, 7, 9, generator=rng, dtype=torch.float64) for _ in range(2))
    flow = 6 * torch.rand(2, 2, 7, 9, generator=rng, dtype=torch.float64) - 3
    rows, columns = torch.meshgrid(torch.arange(7.0), torch.arange(9.0), indexing="ij")
    x, y = columns + flow[:, 0], rows + flow[:, 1]
    grid = torch.stack([x / 8 * 2 - 1, y / 6 * 2 - 1], dim=-1)
    source = other.requires_grad_()
    sampled = torch.nn.functional.grid_sample(source, grid, align_corners=True, padding_mode="zeros")
    (sampled * values).sum().backward()
    torch.testing.assert_close(splat_sum(values, flow), source.grad)
    inside = 0.2 * torch.rand(2, 2, 7, 9, generator=rng, dtype=torch.float64)
    centre = torch.zeros_like(values)
    centre[:, :, 1:5, 1:7] = values[:, :, 1:5, 1:7]
    torch.testing.assert_close(splat_sum(centre, inside).sum(), centre.sum())


def test_camera_of_the_padded_and_halved_image() -> None:
    """A point's pixel at half size plus padding, by the full camera's own projection."""
    camera = StereoCamera(200, 100, 140.0, 130.0, 101.0, 47.0, (0.5, 0.0, 0.0))
    fed = _camera_of(camera, (50, 100), (slice(7, 57), slice(14, 114)))
    point = np.array([1.0, -0.5, 4.0])
    full = camera.intrinsics @ point
    # Pixel centres: full-size x covers half-size (x + 0.5) / 2 - 0.5.
    expected = (full[:2] / full[2] + 0.5) / 2 - 0.5 + [14, 7]
    seen = fed.intrinsics @ point
    np.testing.assert_allclose(seen[:2] / seen[2], expected)
    assert _camera_of(camera, (100, 200), (slice(0, 100), slice(0, 200))) == camera


def test_size_of_a_motion() -> None:
    T = np.eye(4)
    T[:3, 3] = [3.0, 0.0, 4.0]
    T[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    assert size_of(T) == pytest.approx((5.0, 90.0))


@pytest.mark.parametrize(("first", "second"), [(0, 1), (4, 2)])
def test_motion_in_the_street_is_the_true_one(first: int, second: int) -> None:
    plugin = registry.lookup("dataset", "street")
    dataset = plugin.cls(replace(plugin.config(name="street"), frames=5))
    trajectory, depth = dataset.ground_truth(), dataset.true_depth(first)
    before, now = dataset.frame(first), dataset.frame(second)
    poses = [trajectory.pose_of(frame.number) for frame in (before, now)]
    truth = np.linalg.inv(poses[1]) @ poses[0]
    T = motion_between(before.left, depth, now.left, dataset.camera)
    error_m, error_deg = size_of(np.linalg.inv(truth) @ T)
    assert size_of(truth)[0] > 0.1
    assert error_m < 0.03
    assert error_deg < 0.1
    np.testing.assert_array_equal(T, motion_between(before.left, depth, now.left, dataset.camera))
    # A frame of another place has no motion to find.
    noise = np.random.default_rng(0).integers(0, 256, now.left.shape, dtype=np.uint8)
    assert motion_between(before.left, depth, noise, dataset.camera) is None
    assert motion_between(np.zeros_like(noise), depth, now.left, dataset.camera) is None


@pytest.mark.parametrize("gap", [1, 3])
def test_motion_on_kitti_with_sgbm_depth(kitti_root: Path, gap: int) -> None:
    """About a metre a frame; poses and images are KITTI's own, the depth is SGBM's."""
    plugin = registry.lookup("dataset", "kitti")
    dataset = plugin.cls(replace(plugin.config(name="kitti"), root=str(kitti_root), sequence="06"))
    stereo = registry.lookup("stereo", "sgbm")
    matcher = stereo.cls(stereo.config(name="sgbm"))
    before, now = dataset.frame(4), dataset.frame(4 + gap)
    depth = matcher.depth(before, 4, dataset.camera).depth
    T = motion_between(before.left, depth, now.left, dataset.camera)
    truth = [dataset.ground_truth().pose_of(frame.number) for frame in (before, now)]
    expected = np.linalg.inv(truth[1]) @ truth[0]
    error_m, error_deg = size_of(np.linalg.inv(expected) @ T)
    assert error_m < 0.05 * gap
    # KITTI's own poses are no better from frame to frame.
    assert error_deg < 0.15 * gap
