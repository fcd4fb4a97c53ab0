"""What SplaTAM's tracker and mapper are made of, against autograd, finite differences and cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from torch import Tensor

from bench.authoring.random_scenes import SceneSpec, random_scene
from bench.baselines.splatam.camera_pose import IDENTITY, CameraPose, PoseOptimizer, extrapolated
from bench.baselines.splatam.densification import gaussians_of, to_add
from bench.baselines.splatam.overlap import overlap_window, share_inside
from bench.baselines.splatam.tracking_loss import TrackingLoss
from bench.contracts.rasterizer import Rendered
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.gaussians.parameters import NamedParameters
from bench.registry import PluginConfig
from bench.types import Float, PinholeView
from plugins.rasterizers.cpu import CpuRasterizer
from plugins.rasterizers.reference import ReferenceRasterizer


def moved(view: PinholeView, twist: Float) -> PinholeView:
    """The view whose camera coordinates are exp(twist) times those of ``view``, by scipy's matrix exponential."""
    (x, y, z), (a, b, c) = twist[:3], twist[3:]
    generator = np.array([[0, -c, b, x], [c, 0, -a, y], [-b, a, 0, z], [0, 0, 0, 0]])
    T_world_cam = np.linalg.inv(expm(generator) @ view.T_cam_world)
    return PinholeView(T_world_cam, view.fx, view.fy, view.cx, view.cy, view.width, view.height)


def rotated(points: Tensor, quaternion: Tensor) -> Tensor:
    """Points (N, 3) turned by the normalised quaternion (x, y, z, w): v + 2 u x (u x v + w v)."""
    q = torch.nn.functional.normalize(quaternion, dim=0)
    u = q[:3].expand_as(points)
    return points + 2 * torch.linalg.cross(u, torch.linalg.cross(u, points) + q[3] * points)


def test_gradient_by_quaternion_and_translation_against_autograd() -> None:
    random = torch.Generator().manual_seed(0)
    points, weights = (torch.randn(20, 3, dtype=torch.float64, generator=random) for _ in range(2))
    quaternion = torch.tensor([0.4, -0.9, 0.2, 1.1], dtype=torch.float64, requires_grad=True)
    translation = torch.tensor([0.3, -2.0, 0.7], dtype=torch.float64, requires_grad=True)
    in_camera = rotated(points, quaternion) + translation
    (weights * in_camera**3).sum().backward()
    by_points = (3 * weights * in_camera**2).detach()
    twist = torch.cat([by_points.sum(0), torch.linalg.cross(in_camera.detach(), by_points).sum(0)])
    pose = CameraPose(quaternion.detach().numpy(), translation.detach().numpy())
    expected = torch.cat([quaternion.grad, translation.grad])  # type: ignore[list-item]
    np.testing.assert_allclose(pose.gradient(twist.numpy()), expected.numpy(), rtol=1e-12, atol=1e-10)


def test_two_steps_of_adam_by_hand() -> None:
    """The first step is the rate whatever the gradient; the opposite gradient then leaves a mean of -0.01 / 0.19."""
    start = CameraPose.of_vector(np.array([0.4, -0.9, 0.2, 1.1, 0.3, -2.0, 0.7]))
    rates, gradient = np.array([4e-4] * 4 + [2e-3] * 3), np.array([3.0, -50, 1, 1, -4, 700, 1])
    optimizer = PoseOptimizer(4e-4, 2e-3)
    once = optimizer.step(start, gradient)
    np.testing.assert_allclose(once.vector, start.vector - rates * np.sign(gradient), rtol=1e-9)
    twice = optimizer.step(once, -gradient)
    np.testing.assert_allclose(twice.vector, once.vector + rates * np.sign(gradient) * 0.01 / 0.19, rtol=1e-9)


def test_constant_velocity_and_the_pose_as_a_matrix() -> None:
    quaternions = Rotation.from_rotvec([[0, 0, 0], [0, 0.02, 0]]).as_quat()
    before, last = (
        CameraPose(quaternions[0], np.array([0.0, 0, 1])),
        CameraPose(3 * quaternions[1], np.array([1.0, 0, 3])),
    )
    ahead = extrapolated(before, last)
    np.testing.assert_allclose(ahead.translation, [2, 0, 5])
    # Linear in the quaternion, which for a small angle is the same angle again.
    np.testing.assert_allclose(Rotation.from_quat(ahead.quaternion).as_rotvec(), [0, 0.04, 0], atol=1e-5)
    T_cam_world = np.eye(4)
    T_cam_world[:3, :3], T_cam_world[:3, 3] = Rotation.from_quat(quaternions[1]).as_matrix(), last.translation
    np.testing.assert_allclose(last.T_world_cam, np.linalg.inv(T_cam_world), atol=1e-12)
    np.testing.assert_array_equal(IDENTITY.T_world_cam, np.eye(4))


def test_only_pixels_that_the_map_is_sure_of_count() -> None:
    """Four pixels: counts; alpha at the threshold; depth unknown; counts with an error in one channel."""
    image = np.full((1, 4, 3), 51, np.uint8)  # 0.2
    loss = TrackingLoss(image, np.array([[2, 2, np.nan, 4]], np.float32), 0.99, 1.0, 0.5)
    color, depth = torch.full((3, 1, 4), 0.2), torch.tensor([[2.5, 9.0, 9.0, 3.0]])
    color[0, 0, 3], color[:, 0, 1:3] = 0.5, 0.9
    alpha = torch.tensor([[0.995, 0.99, 1.0, 1.0]])
    value, by_color, by_depth = loss.evaluate(color, depth, alpha)
    assert value == pytest.approx(0.5 + 1.0 + 0.5 * 0.3)
    assert (loss.pixels, loss.depth_loss) == (2, 1.5)
    np.testing.assert_array_equal(by_depth, [[1, 0, 0, -1]])
    assert by_color[0, 0, 3] == 0.5
    assert not by_color[:, 0, 1:3].any()


def test_twist_of_the_tracking_loss_against_finite_differences() -> None:
    """In float64 through the reference rasterizer, with the mask of the view at rest, which has no gradient."""
    planes, view = random_scene(SceneSpec(1, 60, 48, 30, 2.0, (0.7, 0.99)))
    generator = np.random.default_rng(0)
    image = generator.integers(0, 256, (30, 48, 3)).astype(np.uint8)
    sensed = np.where(generator.random((30, 48)) < 0.8, generator.uniform(1, 9, (30, 48)), np.nan).astype(np.float32)
    loss, gaussians = TrackingLoss(image, sensed, 0.9, 1.0, 0.5), GaussianMap(0, "cpu")
    gaussians.add(0, np.eye(4), planes, torch.ones(planes.shape[1]))
    value, gradient = GaussianMapView(gaussians, CpuRasterizer(PluginConfig("cpu"))).differentiate(view, loss)
    exact, step = ReferenceRasterizer(PluginConfig("reference")), 1e-7
    at_rest = exact.render(planes.double(), view, differentiable=False)
    mask = (at_rest.alpha > 0.9) & torch.from_numpy(np.isfinite(sensed))
    target = torch.from_numpy(image).permute(2, 0, 1) / 255.0

    def at(twist: Float) -> float:
        rendered = exact.render(planes.double(), moved(view, twist), differentiable=False)
        of_depth = (rendered.depth - torch.from_numpy(np.nan_to_num(sensed))).abs()[mask].sum()
        return float(of_depth + 0.5 * (rendered.color - target).abs()[:, mask].sum())

    differences = [(at(step * axis) - at(-step * axis)) / (2 * step) for axis in np.eye(6)]
    assert loss.pixels == int(mask.sum()) > 50
    assert value == pytest.approx(at(np.zeros(6)), rel=1e-4)
    np.testing.assert_allclose(gradient, differences, rtol=2e-3, atol=2e-3 * np.abs(differences).max())


@pytest.mark.parametrize(("unknown", "added"), [(0, [0, 4]), (3, [0, 3, 4])])
def test_two_rules_of_densification(unknown: int, added: list[int]) -> None:
    """Six pixels of depth 2 m: thin; before by 1.5 m; as it is; behind by 1 cm; behind by 0.6 m; thin and unknown.

    The errors but for the unknown are 0, 1.5, 0, 0.01, 0.6 m and 0; the lower median is 0.01 m with two more of 0.011,
    and 50 times that is between 1 cm and 0.6 m. With more pixels of unknown depth than known the median is 0, and what
    lies behind by 1 cm is replaced too.
    """
    depth = torch.tensor([[2.0, 2.0, 2.0, 2.0, 2.0, 0.0, 2.0, 2.0, *[0.0] * unknown]])
    shown = torch.tensor([[2.0, 0.5, 2.0, 2.01, 2.6, 9.0, 1.989, 1.989, *[9.0] * unknown]])
    alpha = torch.tensor([[0.49, 1.0, 0.5, 1.0, 1.0, 0.0, 1.0, 1.0, *[1.0] * unknown]])
    chosen = to_add(Rendered(torch.zeros(3, *depth.shape), shown, alpha), depth, 0.5)
    assert np.flatnonzero(chosen).tolist() == added


def test_a_new_gaussian_is_one_pixel_large() -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], (10, 0, 0)  # looks along the world's x axis
    view = PinholeView(T, 20.0, 30.0, 1.0, 0.0, 3, 2)
    which, depth = torch.tensor([[False, False, True], [False] * 3]), torch.full((2, 3), 5.0)
    made = NamedParameters(gaussians_of(which, torch.full((3, 2, 3), 0.25), depth, view))
    np.testing.assert_allclose(made.means, [[15, 0, -0.25]], atol=1e-6)  # a pixel to the right: 5 m / 20 px
    np.testing.assert_allclose(made.scales, np.full((1, 3), 5 / 25), rtol=1e-6)
    np.testing.assert_allclose(made.opacities, [0.5])
    np.testing.assert_allclose(made.colors, [[0.25] * 3], rtol=1e-6)
    np.testing.assert_allclose(made.quaternions, [[1, 0, 0, 0]])


def looking(x: float, turned: float = 0.0) -> PinholeView:
    T = np.eye(4)
    T[:3, :3], T[0, 3] = Rotation.from_rotvec([0, turned, 0]).as_matrix(), x
    return PinholeView(T, 50.0, 50.0, 49.5, 49.5, 100, 100)


def test_share_of_points_inside() -> None:
    """At 10 m the 100 px image shows 20 m, and 60 px of it are inside the border: points at x = -6 to 6 m."""
    points = np.array([[-7.0, 0, 10], [-5, 0, 10], [0, 0, 10], [5, 0, 10], [5, 9, 10]])
    assert share_inside(points, looking(0.0)) == pytest.approx(3 / 5)
    assert share_inside(points, looking(5.0)) == pytest.approx(2 / 5)
    assert share_inside(points, looking(0.0, np.pi)) == 0.0  # behind the camera
    assert share_inside(np.zeros((0, 3)), looking(0.0)) == 0.0


def test_window_of_overlapping_keyframes() -> None:
    stored = {0: looking(0.0), 5: looking(0.0, np.pi), 10: looking(1.0), 15: looking(2.0), 20: looking(0.0, np.pi)}
    depth = np.zeros((100, 100), np.float32)
    depth[::2] = 10.0
    draw = [overlap_window(looking(0.0), depth, stored, 4, np.random.default_rng(seed)) for seed in range(20)]
    assert {tuple(sorted(window[:-1])) for window in draw} == {
        (0, 10),
        (0, 15),
        (10, 15),
    }  # never the one that looks away
    assert {window[-1] for window in draw} == {20}  # the last one, whatever it sees
    assert overlap_window(looking(0.0), depth, stored, 2, np.random.default_rng(0)) == [20]
    assert overlap_window(looking(0.0), depth * 0, stored, 9, np.random.default_rng(0)) == [20]
    assert overlap_window(looking(0.0), depth, {}, 9, np.random.default_rng(0)) == []
