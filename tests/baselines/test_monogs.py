"""MonoGS's parts: the tracking loss against autograd, its rules on cases worked by hand, and a break to the bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from torch import Tensor

from bench import registry
from bench.authoring.random_scenes import SceneSpec, random_scene
from bench.baselines.monogs.cameras import CameraAdam, KeyframeCameras
from bench.baselines.monogs.density import (
    DensityRules,
    ImageGradients,
    densify_and_prune,
    isotropy_gradient,
    screen_radius,
)
from bench.baselines.monogs.images import TrackingLoss, edge_mask, not_black
from bench.baselines.monogs.insertion import adapted_point_size, neighbour_distance2, new_gaussians, usable_depth
from bench.contracts.map_view import MapView
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.gaussians.parameters import NamedParameters, planes_from
from bench.gaussians.schema import LOG_SCALE
from bench.registry import PluginConfig
from bench.types import (
    DepthMap,
    Float,
    Keyframe,
    PinholeView,
    RenderedView,
    StereoCamera,
    StereoFrame,
    TrackingResult,
    Trajectory,
)
from plugins.keyframers.monogs import MonoGSKeyframer, MonoGSKeyframerConfig, leaves_window, most_crowded
from plugins.mappers.monogs import MonoGSMapper, MonoGSMapperConfig
from plugins.rasterizers.reference import ReferenceRasterizer
from plugins.trackers.monogs import MonoGSTracker, MonoGSTrackerConfig

CAMERA = StereoCamera(48, 32, 40.0, 40.0, 23.5, 15.5, (0.1, 0.0, 0.0))


def map_of(planes: Tensor) -> GaussianMap:
    made = GaussianMap(0, torch.device("cpu"))
    made.add(0, np.eye(4), planes, torch.ones(planes.shape[1]))
    return made


def test_tracking_gradients_by_twist_and_exposure_against_finite_differences() -> None:
    """In float64, with the opacity of the weights held fixed, as the loss says."""
    planes, view = random_scene(SceneSpec(1, 40, 30, 20, 2.0, (0.1, 0.9)))
    random = np.random.default_rng(0)
    image = random.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    depth = np.where(random.random((20, 30)) < 0.2, np.nan, random.uniform(1, 6, (20, 30))).astype(np.float32)
    mask = random.random((20, 30)) < 0.7
    exact = ReferenceRasterizer(PluginConfig("reference"))
    fixed = exact.render(planes.double(), view, differentiable=False).alpha

    def value(twist: Float, a: float, b: float) -> float:
        (x, y, z), (i, j, k) = twist[:3], twist[3:]
        motion = expm(np.array([[0, -k, j, x], [k, 0, -i, y], [-j, i, 0, z], [0, 0, 0, 0]]))
        there = replace(view, T_world_cam=np.linalg.inv(motion @ view.T_cam_world))
        drawn = exact.render(planes.double(), there, differentiable=False)
        error = np.abs(np.exp(a) * drawn.color.numpy() + b - image.transpose(2, 0, 1) / 255)
        known = np.isfinite(depth) & (fixed.numpy() > 0.95)
        off = np.abs(drawn.depth.numpy() - np.nan_to_num(depth)) * known
        return float(0.9 * (fixed.numpy() * mask * error).mean() + 0.1 * off.mean())

    loss = TrackingLoss(image, depth, mask, 0.9)
    loss.exposure = (0.2, -0.05)
    found, by_twist = GaussianMapView(map_of(planes.double()), exact).differentiate(view, loss)
    at = np.array([0, 0, 0, 0, 0, 0, 0.2, -0.05])
    steps = 1e-7 * np.eye(8)
    expected = [(value((at + s)[:6], *(at + s)[6:]) - value((at - s)[:6], *(at - s)[6:])) / 2e-7 for s in steps]
    assert found == pytest.approx(value(at[:6], 0.2, -0.05), rel=1e-5)
    np.testing.assert_allclose([*by_twist, *loss.by_exposure], expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_the_edge_mask_is_scharrs_gradient_above_the_median() -> None:
    """A ramp of one grey value a column, an edge, and black on the right."""
    image = np.full((64, 96, 3), 100, np.uint8)
    image[:, :48] = (100 + np.arange(48, dtype=np.uint8))[None, :, None]
    image[:, 60:] += 60
    image[:, 80:] = 0
    mask = edge_mask(image, 1.1, blocks=False)
    assert mask[:, 59:61].all()
    assert not mask[:, 62:78].any()
    # A neighbour is black: the step to it does not count.
    assert not mask[:, 79:].any()
    # In a block of 2 x 3 pixels, columns 57 to 59, two thirds are level: the median is 0, and the edge counts.
    assert edge_mask(image, 4.0, blocks=True)[:, 59].all()
    # On the ramp all of a block change alike: none is four times the median.
    assert not edge_mask(image, 4.0, blocks=True)[:, :45].any()
    np.testing.assert_array_equal(not_black(image)[0], np.arange(96) < 80)
    assert not not_black(np.full((1, 1, 3), [1, 1, 0], np.uint8)).any()


def test_adam_of_a_camera_by_hand() -> None:
    """A first step is as long as the rate; without a gradient the next is 0.09 / 0.19 / sqrt(0.999 / 1.999) of it."""
    adam = CameraAdam(0.001, 0.003, 0.01)
    twist, change = adam.step(np.array([5.0, -5, 5, 1, 1, -1]), (2.0, -2.0))
    np.testing.assert_allclose(twist, [-0.001, 0.001, -0.001, -0.003, -0.003, 0.003], rtol=1e-6)
    np.testing.assert_allclose(change, [-0.01, 0.01], rtol=1e-6)
    again, _ = adam.step(np.zeros(6), (0.0, 0.0))
    np.testing.assert_allclose(again / twist, 0.09 / 0.19 / np.sqrt(0.999 / 1.999), rtol=1e-6)


def test_the_size_of_new_gaussians_by_hand() -> None:
    """Four pixels in a row at 2 m, 0.1 m apart: the ends are 0.1, 0.2, 0.3 m from others, the rest 0.1, 0.1, 0.2."""
    view = PinholeView(np.eye(4), 20.0, 20.0, 0.0, 0.0, 4, 1)
    image = np.full((1, 4, 3), 128, np.uint8)
    depth = np.full((1, 4), 2.0, np.float32)
    planes = new_gaussians(image, depth, view, 1.0, 0.25, (np.log(2.0), 0.1), np.random.default_rng(0))
    named = NamedParameters(planes)
    np.testing.assert_allclose(named.means.numpy(), [[0.1 * k, 0, 2] for k in range(4)], atol=1e-6)
    sigma = 0.5 * np.sqrt(np.array([0.14, 0.06, 0.06, 0.14]) / 3)
    np.testing.assert_allclose(named.scales.numpy(), np.repeat(sigma[:, None], 3, 1), rtol=1e-5)
    np.testing.assert_allclose(named.opacities.numpy(), 0.5)
    np.testing.assert_allclose(named.colors.numpy(), (128 / 255 - 0.1) / 2, rtol=1e-5)
    assert neighbour_distance2(np.zeros((1, 3))).tolist() == [0.0]
    assert neighbour_distance2(np.array([[0.0, 0, 0], [0, 3, 0]])).tolist() == [9.0, 9.0]
    halved = new_gaussians(image, depth, view, 0.6, 0.25, (0.0, 0.0), np.random.default_rng(0))
    assert halved.shape == (14, 2)


def test_which_depth_counts_and_how_the_point_size_follows_it() -> None:
    image = np.full((1, 5, 3), 90, np.uint8)
    image[0, 3] = 0
    depth = np.array([[np.nan, 2.0, 101.0, 3.0, 4.0]], np.float32)
    used = usable_depth(image, depth, 100.0)
    np.testing.assert_array_equal(used, [[0, 2, 0, 0, 4]])
    assert adapted_point_size(0.01, used) == 0.0  # the median over all pixels, as in the original
    assert adapted_point_size(0.01, used[:, [1, 1, 4]]) == pytest.approx(0.02)
    assert adapted_point_size(0.05, used[:, [1, 1, 4]]) == 0.05


def gaussians(scales: list[tuple[float, float, float]], opacities: list[float], z: float = 2.0) -> Tensor:
    count = len(scales)
    means = torch.tensor([[0.1 * k, 0.0, z] for k in range(count)])
    upright = torch.tensor([[1.0, 0, 0, 0]] * count)
    return planes_from(means, torch.tensor(scales), upright, torch.tensor(opacities), torch.full((count, 3), 0.5))


def test_densify_and_prune_by_hand() -> None:
    """Of five: one stays, one is cloned, one split, one is too pale and one too large."""
    small, large, huge = (0.02,) * 3, (0.02, 0.1, 0.02), (0.9, 0.02, 0.02)
    planes = gaussians([small, small, large, small, huge], [0.9, 0.9, 0.9, 0.6, 0.9])
    rules = DensityRules(2e-4, 0.06, 0.7, 0.6, np.inf)
    made = map_of(planes)
    gradients = torch.tensor([1e-4, 2e-4, 3e-4, 1e-4, 0.0])
    assert densify_and_prune(made, gradients, rules, (), np.random.default_rng(0)) == (3, 3)
    named = NamedParameters(made.planes)
    largest = named.scales.amax(1)
    np.testing.assert_allclose(largest.numpy(), [0.02, 0.02, 0.02, 0.1 / 1.6, 0.1 / 1.6], rtol=1e-5)
    np.testing.assert_array_equal(made.planes[:, 2], planes[:, 1])
    assert not torch.equal(named.means[3], named.means[4])
    assert float((named.means[3:] - NamedParameters(planes).means[2]).abs().max()) < 0.5
    assert not made.first_moment.any()


def test_radii_in_the_image_and_their_rule() -> None:
    """A round Gaussian of 0.1 m, 2 m ahead with f = 40 px: sigma^2 = 4 + 0.3 px^2, three sigma 6.2, rounded up."""
    planes = gaussians([(0.1, 0.1, 0.1), (0.01, 0.01, 0.01)], [0.9, 0.9])
    planes[0, 1] = 0.0
    view = PinholeView.of(CAMERA, np.eye(4))
    assert screen_radius(planes, view).tolist() == [7.0, 2.0]
    behind = planes.clone()
    behind[2] = -2.0
    assert screen_radius(behind, view).tolist() == [0.0, 0.0]
    made = map_of(planes)
    rules = DensityRules(1.0, 1.0, 0.1, np.inf, 6.5)
    assert densify_and_prune(made, torch.zeros(2), rules, (view,), np.random.default_rng(0)) == (0, 1)
    assert len(made) == 1


def test_gradients_by_the_place_in_the_image() -> None:
    """Of a small Gaussian: by autograd through the centre alone, in half images, from the gradient by its place."""
    planes = gaussians([(1e-3, 1e-3, 1e-3)], [0.9], z=3.0)
    T = np.eye(4)
    T[:3, :3] = expm(np.array([[0, -0.3, 0.2], [0.3, 0, -0.1], [-0.2, 0.1, 0]]))
    view = PinholeView.of(CAMERA, np.linalg.inv(T))
    exact = ReferenceRasterizer(PluginConfig("reference"))
    sums = ImageGradients(torch.device("cpu"))
    sums.reset(1)
    rendered = exact.render(planes.double(), view)
    weight = torch.from_numpy(np.random.default_rng(0).random((32, 48)))
    gradients = exact.backward(rendered, None, None, weight)
    sums.add(planes.double(), view, gradients)
    p = T[:3, :3] @ planes[:3, 0].numpy()
    center = torch.tensor([40 * p[0] / p[2] + 23.5, 40 * p[1] / p[2] + 15.5], dtype=torch.float64, requires_grad=True)
    ys, xs = torch.meshgrid(torch.arange(32.0), torch.arange(48.0), indexing="ij")
    d2 = (xs - center[0]) ** 2 + (ys - center[1]) ** 2
    variance = 0.3 + (40 * 1e-3 / p[2]) ** 2
    alpha = 0.9 * torch.exp(-d2 / (2 * variance))
    (weight * torch.where(alpha >= 1 / 255, alpha, 0.0)).sum().backward()
    assert center.grad is not None
    expected = float(torch.hypot(center.grad[0] * 24, center.grad[1] * 16))
    assert float(sums.means()[0]) == pytest.approx(expected, rel=1e-2)


def test_the_isotropy_term_against_autograd() -> None:
    planes = gaussians([(0.1, 0.2, 0.6), (0.3, 0.1, 0.1)], [0.9, 0.9]).double()
    log_scales = planes[LOG_SCALE].clone().requires_grad_()
    scales = log_scales.exp()
    (10.0 * (scales - scales.mean(0)).abs().mean()).backward()
    assert log_scales.grad is not None
    np.testing.assert_allclose(isotropy_gradient(planes, 10.0).numpy(), log_scales.grad.numpy(), rtol=1e-9)


class Sights(MapView):
    """A map of 100 elements whose views, told by the camera's x in metres, see a stretch of them each."""

    def __init__(self, sees: dict[float, tuple[int, int]], depth: float) -> None:
        self._sees, self._depth = sees, depth

    def render(self, view: PinholeView) -> RenderedView:
        shape = (view.height, view.width)
        full = np.full(shape, self._depth, np.float32)
        return RenderedView(np.zeros((*shape, 3), np.float32), full, np.ones(shape, np.float32))

    def differentiate(self, view: PinholeView, loss: Any) -> tuple[float, Float]:
        raise NotImplementedError

    def seen(self, view: PinholeView) -> Any:
        first, end = self._sees[round(float(view.T_world_cam[0, 3]), 6)]
        counts = np.zeros(100, np.int32)
        counts[first:end] = 3
        return counts

    def median_depth(self, view: PinholeView) -> Any:
        raise NotImplementedError


def at_x(x: float) -> Float:
    T = np.eye(4)
    T[0, 3] = x
    return T


def decided(
    places: list[tuple[float, tuple[int, int]]], depth: float = 10.0, **settings: Any
) -> list[tuple[bool, tuple[int, ...]]]:
    keyframer = MonoGSKeyframer(MonoGSKeyframerConfig("monogs", **settings))
    keyframer.start(CAMERA)
    keyframer.use_map(Sights(dict(places), depth))
    found = []
    for number, (x, _) in enumerate(places):
        frame = StereoFrame(number, 0.0, np.zeros((32, 48, 3), np.uint8))
        decision = keyframer.update(frame, TrackingResult(at_x(x), "ok"))
        found.append((decision.is_keyframe, decision.window))
    return found


@pytest.mark.parametrize(
    ("x", "sees", "window_size", "expected"),
    [
        (0.2, (0, 96), 2, False),  # IoU 0.96, moved 2 % of the depth
        (0.3, (5, 100), 2, False),  # IoU 0.95 is not below 0.95
        (0.1, (10, 100), 2, False),  # little overlap, moved less than 2 %
        (0.3, (10, 100), 2, True),  # little overlap, moved more than 2 %
        (0.5, (0, 100), 2, True),  # moved more than 4 %
        (0.5, (0, 100), 3, False),  # window not full: overlap alone counts
        (0.1, (10, 100), 3, True),
    ],
)
def test_the_keyframe_rule(x: float, sees: tuple[int, int], window_size: int, expected: bool) -> None:
    """Two keyframes, then the frame in question; IoU is by the elements seen, depth 10 m."""
    places = [(-1.0, (0, 50)), (0.0, (0, 100)), (x, sees)]
    assert [each for each, _ in decided(places, interval=1, window_size=window_size)] == [True, True, expected]


def test_the_interval_counts_frames_since_the_last_keyframe() -> None:
    places = [(float(k), (10 * k, 10 * k + 10)) for k in range(7)]
    assert [each for each, _ in decided(places, interval=3)] == [True, False, False, True, False, False, True]
    # With a full window it no longer holds, where it is not to.
    relaxed = decided(places, interval=3, interval_always=False, window_size=2)
    assert [each for each, _ in relaxed] == [True, False, False, True, True, True, True]


def test_the_oldest_of_those_without_overlap_leaves_the_window() -> None:
    sights = [np.zeros(100, bool) for _ in range(5)]
    for sight, (first, end) in zip(sights, [(50, 100), (0, 10), (60, 80), (0, 60), (0, 52)], strict=True):
        sight[first:end] = True
    # Of the fewer seen: the second is not asked, 20 of 20, 10 of 50, 2 of 50.
    assert leaves_window(sights, 0.3) == 4
    assert leaves_window(sights[:4], 0.3) == 3
    assert leaves_window(sights[:4], 0.1) is None
    assert leaves_window([sights[0], np.zeros(100, bool), np.zeros(100, bool)], 0.3) == 2


def test_the_most_crowded_of_the_old_leaves_a_full_window() -> None:
    """sqrt(8) (1/1 + 1/6) = 3.30, 3 (1/1 + 1/5) = 3.6, sqrt(14) (1/5 + 1/6) = 1.37."""
    centres = [np.array([x, 0.0, 0.0]) for x in (0.0, 1.0, 8.0, 9.0, 14.0)]
    assert most_crowded(centres) == 3
    window = decided([(float(-k), (0, 100)) for k in range(4)], interval=1, window_size=3, overlap=1.0, translation=0.0)
    assert window[-1] == (False, (0,))


def test_poses_follow_the_tracker_unless_it_has_taken_them_over() -> None:
    cameras = KeyframeCameras()
    for number in (0, 4):
        cameras.add(number, at_x(float(number)), None)
    cameras.begin([4, 0], 2, 0.1, 0.1, 0.1)
    assert not cameras.learns(0)
    cameras.step(4, np.array([1.0, 0, 0, 0, 0, 0]), (1.0, -1.0))
    refined = cameras.pose(4)
    assert refined is not None
    np.testing.assert_allclose(refined, at_x(4.1), atol=1e-6)  # the world moves left in the camera: it goes right
    np.testing.assert_allclose(cameras.exposure(4), (-0.1, 0.1), atol=1e-6)
    # A frame between the two gets half of the correction.
    np.testing.assert_allclose(cameras.corrected(2, at_x(2.0)), at_x(2.05), atol=1e-6)
    numbers, times = np.array([0, 4]), np.zeros(2)
    assert not cameras.follow(Trajectory(np.stack([at_x(0.0), at_x(4.0)]), numbers, times))
    assert not cameras.follow(Trajectory(np.stack([at_x(0.0), refined]), numbers, times))
    np.testing.assert_allclose(cameras.corrected(2, at_x(2.0)), at_x(2.0), atol=1e-12)
    motions = cameras.follow(Trajectory(np.stack([at_x(0.0), at_x(1.0) @ refined]), numbers, times))
    assert list(motions) == [4]
    np.testing.assert_allclose(cameras.pose(4), at_x(5.1), atol=1e-6)


def keyframes(count: int) -> list[Keyframe]:
    """A wall with a pattern, 2 m away; the camera moves right by 10 cm a frame, 2 px."""
    found = []
    v, u = np.mgrid[:32, :48]
    for k in range(count):
        phase = (u + 2.0 * k) / 5
        image = np.stack([128 + 80 * np.sin(phase), 128 + 80 * np.cos(v / 4), 90 + 60 * np.sin(phase + v / 6)], 2)
        depth = np.full((32, 48), 2.0, np.float32)
        depth[:2] = np.nan
        frame = StereoFrame(k, 0.1 * k, image.astype(np.uint8), None, DepthMap(depth, "hand"))
        found.append(Keyframe(frame, frame.depth, None, at_x(0.1 * k), (0.01, 0.0)))  # type: ignore[arg-type]
    return found


def small_mapper(**settings: Any) -> MonoGSMapper:
    rasterizer = registry.lookup("rasterizer", "cpu").config("cpu")
    counts: dict[str, Any] = {"first_iterations": 12, "iterations": 6, "densify_every": 9, "refinement_iterations": 4}
    # So few iterations make nothing as opaque as 0.7.
    counts |= {"first_downsample": 4, "downsample": 8, "color_rate": 0.05, "prune_opacity": 0.3}
    config = MonoGSMapperConfig("monogs", rasterizer=rasterizer, **counts | settings)
    mapper = MonoGSMapper(config)
    mapper.start(CAMERA, [], 0)
    return mapper


def through_a_state(part: Any, fresh: Any, *more: Any) -> Any:
    fresh.restore(part.state(), *more)
    return fresh


def test_a_run_is_resumed_to_the_bit() -> None:
    """Tracker, keyframer and mapper together, with and without a break after the third frame and in the refinement."""

    def run(broken: bool) -> tuple[Float, Tensor, list[Any]]:
        def looking(mapper: MonoGSMapper) -> tuple[MonoGSTracker, MonoGSKeyframer]:
            edges = {"edge_blocks": False, "edge_threshold": 1.0}
            tracker = MonoGSTracker(
                MonoGSTrackerConfig("monogs", 5, translation_rate=0.02, start="constant_velocity", **edges)
            )
            keyframer = MonoGSKeyframer(MonoGSKeyframerConfig("monogs", interval=1, overlap=1.0, window_size=3))
            tracker.start(type("Sequence", (), {"camera": CAMERA})())  # type: ignore[arg-type]
            keyframer.start(CAMERA)
            tracker.use_map(mapper.view())
            keyframer.use_map(mapper.view())
            return tracker, keyframer

        mapper = small_mapper()
        tracker, keyframer = looking(mapper)
        given: list[Keyframe] = []
        decisions = []
        for k, keyframe in enumerate(keyframes(5)):
            tracking = tracker.track(keyframe.frame)
            decision = keyframer.update(keyframe.frame, tracking)
            decisions.append(decision)
            if decision.is_keyframe:
                trajectory = tracker.trajectory()
                mapper.update_poses(trajectory)
                pose = trajectory.pose_of(k)
                assert pose is not None
                given.append(Keyframe(keyframe.frame, keyframe.depth, None, pose, tracking.exposure))
                mapper.add_keyframe(given[-1], decision.window)
            if broken and k == 2:
                mapper_again = through_a_state(mapper, small_mapper(), iter(given))
                again = looking(mapper_again)
                tracker, keyframer = through_a_state(tracker, again[0]), through_a_state(keyframer, again[1])
                mapper = mapper_again
        mapper.update_poses(tracker.trajectory())
        for step, _ in enumerate(mapper.final_steps()):
            if broken and step == 1:
                mapper = through_a_state(mapper, small_mapper(), iter(given))
                mapper.finish()
                break
        return tracker.trajectory().T_world_cam, mapper.state()["map"]["planes"], decisions

    (poses, planes, decisions), other = run(False), run(True)
    assert sum(each.is_keyframe for each in decisions) > 2
    assert decisions == other[2]
    np.testing.assert_array_equal(poses, other[0])
    assert torch.equal(planes, other[1])


def test_the_map_learns_and_refined_poses_reach_whoever_looks_at_it() -> None:
    mapper = small_mapper(first_iterations=30, refinement_iterations=0)
    reports = [mapper.add_keyframe(each, range(k + 1)) for k, each in enumerate(keyframes(3))]
    assert reports[0].psnr_db > 15  # one colour has 14.0
    assert mapper.size()["gaussians"] > 100
    refined = mapper.view().refined_pose(2)
    assert refined is not None
    assert not np.array_equal(refined, at_x(0.2))
    np.testing.assert_array_equal(mapper.view().refined_pose(0), np.eye(4))
    assert mapper.view().refined_pose(7) is None


def test_a_first_keyframe_without_depth_makes_an_empty_map() -> None:
    mapper = small_mapper()
    blind = keyframes(2)
    nothing = DepthMap(np.full((32, 48), np.nan, np.float32), "none")
    mapper.add_keyframe(Keyframe(blind[0].frame, nothing, None, np.eye(4)), [0])
    assert mapper.size() == {"gaussians": 0}
    mapper.add_keyframe(blind[1], [0, 1])
    mapper.finish()
    assert mapper.size()["gaussians"] > 0


def test_gaussians_move_with_keyframes_that_the_tracker_corrects() -> None:
    mapper = small_mapper(first_iterations=2, iterations=1)
    for k, keyframe in enumerate(keyframes(2)):
        mapper.add_keyframe(keyframe, range(k + 1))
    before, refined = mapper.state()["map"], mapper.view().refined_pose(1)
    assert refined is not None
    numbers, times = np.array([0, 1]), np.zeros(2)
    mapper.update_poses(Trajectory(np.stack([np.eye(4), refined]), numbers, times))
    assert torch.equal(mapper.state()["map"]["planes"], before["planes"])
    mapper.update_poses(Trajectory(np.stack([np.eye(4), at_x(1.0) @ refined]), numbers, times))
    shift = mapper.state()["map"]["planes"][:3] - before["planes"][:3]
    expected = (before["anchor"] == 1).float()
    np.testing.assert_allclose(shift.numpy(), [expected.numpy(), 0 * expected.numpy(), 0 * expected.numpy()], atol=1e-5)
    np.testing.assert_allclose(mapper.view().refined_pose(1), at_x(1.0) @ refined, atol=1e-9)
