"""Point-SLAM's parts on cases worked by hand, in float64, and on a wall of a few pixels."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.baselines.point_slam.adding import add_points, candidates
from bench.baselines.point_slam.cloud import PointCloud
from bench.baselines.point_slam.decoders import ColorDecoder, GeometryDecoder
from bench.baselines.point_slam.frames import MappedFrame, in_view, overlap, window_of
from bench.baselines.point_slam.learning import later_iterations
from bench.baselines.point_slam.original_weights import load_geometry
from bench.baselines.point_slam.picture import picture
from bench.baselines.point_slam.radius import RadiusSettings, add_radius, edges
from bench.baselines.point_slam.rays import RayRenderer, Rays, RaySettings, RenderedRays, around
from bench.baselines.point_slam.settings import PointSlamMapperConfig
from bench.baselines.point_slam.tracking import (
    PointSlamTrackerConfig,
    Sight,
    pose_loss,
    rotation_of,
    tracking_loss,
    usable_pixels,
)
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.geometry import se3
from bench.types import DepthMap, Keyframe, PinholeView, StereoCamera, StereoFrame, TrackingResult, Trajectory
from plugins.keyframers.monogs import MonoGSKeyframer, MonoGSKeyframerConfig
from plugins.keyframers.point_slam import PointSlamKeyframer, PointSlamKeyframerConfig
from plugins.mappers.point_slam import PointSlamMapper
from plugins.trackers.monogs import MonoGSTracker, MonoGSTrackerConfig
from plugins.trackers.point_slam import PointSlamTracker
from plugins.trackers.splatam import SplatamTracker, SplatamTrackerConfig

CPU = torch.device("cpu")
CAMERA = StereoCamera(24, 16, 24.0, 24.0, 11.5, 7.5, (0.1, 0.0, 0.0))
SMALL = PointSlamMapperConfig(
    uniform_pixels=120,
    edge_pixels=20,
    rays=60,
    window=2,
    keyframe_every=1,
    first_iterations=6,
    first_geometry_iterations=3,
    iterations=2,
    refinement_rounds=1,
    relative_positions=False,
    radius=RadiusSettings(0.16, 0.08),
    device="cpu",
)


def random(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def cloud_of(points: list[list[float]]) -> PointCloud:
    cloud = PointCloud(CPU)
    cloud.add(np.array(points, np.float64), 0, random())
    return cloud


def wall(number: int, x: float = 0.0) -> Keyframe:
    """A coloured wall 2 m away, seen from ``x`` metres to the side."""
    u, v = np.meshgrid((np.arange(24) - 11.5) / 12 + x, (np.arange(16) - 7.5) / 12)
    image = np.stack([np.sin(3 * u), np.cos(4 * v), np.sin(u + v)], 2) * 100 + 120
    pose = se3.compose(np.eye(3), np.array([x, 0.0, 0.0]))
    depth = DepthMap(np.full((16, 24), 2.0, np.float32), "truth")
    return Keyframe(StereoFrame(number, 0.1 * number, image.astype(np.uint8), None, depth), depth, None, pose)


def frame_of(keyframe: Keyframe, radius: float = 0.05) -> MappedFrame:
    depth = keyframe.depth.depth.copy()
    return MappedFrame(0, keyframe.T_world_cam, keyframe.frame.left, depth, np.full_like(depth, radius))


def test_radius_by_hand() -> None:
    """8 cm up to a magnitude of 0.01, 2 cm from 0.15 on, and half-way 5 cm at 0.08; with ``at_depth_m`` 2.5 four
    times as much at 10 m, and no less nearer by."""
    edge = np.array([0.0, 0.01, 0.08, 0.15, 0.9], np.float32)
    expected = [0.08, 0.08, 0.05, 0.02, 0.02]
    assert add_radius(edge, np.full(5, 40.0, np.float32), RadiusSettings()) == pytest.approx(expected)
    growing = RadiusSettings(at_depth_m=2.5)
    depth = np.array([10.0, 1.0, np.nan, 2.5, 5.0], np.float32)
    assert add_radius(edge, depth, growing) == pytest.approx([0.32, 0.08, 0.05, 0.02, 0.04])


def test_edges_of_a_grey_step() -> None:
    """A step from 0 to 255: Sobel's horizontal difference is half of it beside the step, over the root of two."""
    image = np.zeros((5, 6, 3), np.uint8)
    image[:, 3:] = 255
    assert edges(image)[2] == pytest.approx([0, 0, 2**-0.5, 2**-0.5, 0, 0], abs=1e-6)


def renderer_of(
    cloud: PointCloud, geometry: Callable[..., Tensor], color: Callable[..., Tensor], **settings: Any
) -> RayRenderer:
    """With functions in place of decoders."""
    vars(color).setdefault("relative", False)
    return RayRenderer(cloud, geometry, color, RaySettings(**settings))  # type: ignore[arg-type]


def test_features_are_weighted_by_the_inverse_of_squared_distances() -> None:
    """Points at 0.1, 0.2 and 0.5 m, of which the last is out of reach: 100 / 125 and 25 / 125. One point is too few."""
    cloud = cloud_of([[0.1, 0, 1], [0, 0.2, 1], [0.5, 0, 1]])
    asked: list[Tensor] = []

    def geometry(position: Tensor, feature: Tensor) -> Tensor:
        asked.append(feature)
        return torch.zeros(len(feature))

    def black(position: Tensor, feature: Tensor) -> Tensor:
        return torch.zeros(len(feature), 3)

    renderer = renderer_of(cloud, geometry, black, samples=2)
    axis = torch.tensor([[0.0, 0.0, 1.0]])
    rays = Rays(torch.zeros(1, 3), axis, torch.tensor([[1.0, 9.0]]), torch.tensor([0.3]))
    shown = renderer.render(rays)
    torch.testing.assert_close(asked[0], (0.8 * cloud.geometry[0] + 0.2 * cloud.geometry[1])[None])
    assert not shown.valid, "one sample of two, and two are needed"
    asked.clear()
    renderer.render(rays._replace(radius=torch.tensor([0.15])))
    assert not asked, "a single neighbour"


def test_a_ray_by_hand() -> None:
    """Logits -20, 0 and 10 at 1, 2 and 3 m: alpha .1192, .5, .7311, weights alpha times what is left."""
    cloud = cloud_of([[0, 0, z + 0.01 * k] for z in (1, 2, 3) for k in (-1, 1)])
    values = torch.tensor([-20.0, 0.0, 10.0], dtype=torch.float64)
    colors = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=torch.float64)
    renderer = renderer_of(cloud, lambda p, f: values, lambda p, f: colors, samples=3)
    cloud.geometry, cloud.color = cloud.geometry.double(), cloud.color.double()
    z = torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64)
    axis = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    shown = renderer.render(Rays(torch.zeros(1, 3, dtype=torch.float64), axis, z, torch.full((1,), 0.1)))
    a, b, c = (1 / (1 + np.exp(-0.1 * logit)) for logit in (-20, 0, 10))
    w = np.array([a, (1 - a) * b, (1 - a) * (1 - b) * c])
    depth = (w * [1, 2, 3]).sum() / w.sum()
    assert float(shown.depth) == pytest.approx(depth, abs=1e-8)
    assert float(shown.variance) == pytest.approx((w * (np.array([1, 2, 3]) - depth) ** 2).sum(), abs=1e-8)
    assert shown.color[0].tolist() == pytest.approx((w / w.sum()).tolist(), abs=1e-8)
    assert bool(shown.valid)


def test_samples_lie_around_the_depth() -> None:
    assert around(torch.tensor([10.0]), RaySettings())[0].tolist() == pytest.approx([9.8, 9.9, 10.0, 10.1, 10.2])


def test_a_pixel_adds_points_only_where_none_is_near() -> None:
    """The wall's pixels are 8.3 cm apart. With one point of old and a radius of 5 cm all but its own pixel add three,
    at 1.96, 2 and 2.04 m of depth; then none adds any."""
    frame = frame_of(wall(0))
    pixel = 8 * 24 + 12
    place = np.array([0.5 / 12, 0.5 / 12, 2.0])
    cloud = cloud_of([place.tolist()])
    everywhere = np.arange(24 * 16)
    assert add_points(cloud, frame, everywhere, CAMERA, SMALL, random()) == 3 * (24 * 16 - 1)
    at_pixel = np.hypot(*(cloud.positions[1:, :2] / cloud.positions[1:, 2:] - place[:2] / 2).T.numpy()) < 1e-3
    assert not at_pixel.any()
    assert sorted({round(z, 3) for z in cloud.positions[1:, 2].tolist()}) == [1.96, 2.0, 2.04]
    assert add_points(cloud, frame, everywhere, CAMERA, SMALL, random()) == 0
    assert add_points(cloud, frame, np.array([pixel]), CAMERA, SMALL, random()) == 0


def test_which_pixels_may_add() -> None:
    """Of the first frame the square of median depth over 2.5 m, up to three times, as many; none of unknown depth."""
    keyframe = wall(0)
    frame = frame_of(keyframe)
    frame.depth[:, :4] = np.nan
    frame.depth[:, 4:] = 3.0
    config = replace(SMALL, uniform_pixels=100, edge_pixels=0)
    edge = edges(keyframe.frame.left)
    drawn = candidates(frame, edge, config, True, random())
    assert len(drawn) == len(set(drawn.tolist())) == 144
    assert (drawn % 24 >= 4).all()
    assert len(candidates(frame, edge, config, False, random())) == 100
    edge[:] = 0
    edge[3, 5:10] = 1
    some = candidates(frame, edge, replace(config, uniform_pixels=1, edge_pixels=1), False, random())
    assert len(some) <= 2
    assert set(some[1:].tolist()) <= set(range(3 * 24 + 5, 3 * 24 + 10))


@pytest.mark.parametrize(("added", "iterations"), [(0, 285), (300, 300), (450, 450), (10_000, 600)])
def test_iterations_follow_the_points_added(added: int, iterations: int) -> None:
    assert later_iterations(300, added) == iterations


def test_which_points_a_frame_sees() -> None:
    """Up to 4 pixels outside, up to half a metre behind the wall; nothing behind the camera."""
    frame = frame_of(wall(0))
    right = (23 - 11.5 + 4) / 12
    points = np.array([[0, 0, 1], [0, 0, 2.4], [0, 0, 2.6], [right, 0, 2], [right + 0.2, 0, 2], [0, 0, -1.0]])
    assert in_view(points, frame, CAMERA, 0.5).tolist() == [True, True, False, True, False, False]
    frame.depth[:] = np.nan
    assert in_view(points, frame, CAMERA, 0.5).tolist()[:3] == [True, True, True]


def test_the_window_holds_frames_that_overlap() -> None:
    """A frame that looks the other way is left out, the last keyframe is in it whatever it shows."""
    camera = StereoCamera(240, 160, 240.0, 240.0, 119.5, 79.5, (0.1, 0.0, 0.0))
    depth = np.full((160, 240), 2.0, np.float32)
    image = np.zeros((160, 240, 3), np.uint8)
    back = se3.compose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    here, away, last, now = (
        MappedFrame(k, pose, image, depth, depth) for k, pose in enumerate((np.eye(4), back, back, np.eye(4)))
    )
    pixels = np.array([80 * 240 + 120])
    assert (overlap(now, pixels, here.T_world_cam, camera), overlap(now, pixels, back, camera)) == (1.0, 0.0)
    window = window_of(now, [here, away, last], 12, camera, random())
    assert [frame.number for frame in window] == [0, 2, 3]
    assert [frame.number for frame in window_of(now, [here, here, last], 3, camera, random())] == [0, 2, 3]


def test_tracking_loss_by_hand() -> None:
    """Depths off by .1, .1 and 30 m with a variance of .01: 1 + 1 standard deviations, and the third is something that
    moves or, if it counts, is capped at 300; colours off by .2 in all channels count half."""
    depth = torch.full((3,), 5.0)
    rendered = RenderedRays(
        depth + torch.tensor([0.1, -0.1, 30.0]), torch.full((3,), 0.01), torch.ones(3).bool(), torch.full((3, 3), 0.5)
    )
    color = torch.full((3, 3), 0.3)
    kept = tracking_loss(rendered, depth, color, 0.5, False)
    assert float(kept) == pytest.approx(1 + 1 + 300 + 0.5 * 9 * 0.2, rel=1e-5)
    twelve = RenderedRays(*(torch.cat([part[:2]] * 10 + [part[2:]]) for part in rendered))
    without = tracking_loss(twelve, torch.full((21,), 5.0), torch.full((21, 3), 0.3), 0.5, True)
    assert float(without) == pytest.approx(20 + 0.5 * 60 * 0.2, rel=1e-5)


def test_gradient_of_the_pose_is_that_of_central_differences() -> None:
    """In float64, with real decoders; the variance, which has no gradient, is held where it is."""
    generator = random(1)
    points = torch.rand(300, 3, generator=generator, dtype=torch.float64) * torch.tensor([2.4, 1.6, 0.2])
    cloud = cloud_of((points - torch.tensor([1.2, 0.8, -1.9])).tolist())
    cloud.geometry, cloud.color = 9 * cloud.geometry.double(), 9 * cloud.color.double()
    decoders = GeometryDecoder(generator).double(), ColorDecoder(True, generator).double()
    renderer = RayRenderer(cloud, *decoders, RaySettings(unit_m=20.0))
    keyframe = wall(0)
    sight = Sight(keyframe.frame.left, keyframe.depth.depth, np.full((16, 24), 0.4, np.float32), np.arange(384))
    config = PointSlamTrackerConfig(reject_moving=False)
    held: list[Tensor] = []

    def render(rays: Rays) -> RenderedRays:
        shown = renderer.render(rays)
        held[:] = held or [shown.variance.detach()]
        return shown._replace(variance=held[0])

    def value(pose: Tensor) -> Tensor:
        pixels = np.arange(0, 384, 13)
        return pose_loss(pose[:4], pose[4:], sight, pixels, CAMERA, render, renderer.settings, config)

    start = torch.tensor([0.02, -0.03, 0.01, 0.9, 0.013, -0.021, 0.03], dtype=torch.float64)
    pose = start.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(value(pose), pose)
    with torch.no_grad():
        steps = 1e-6 * torch.eye(7, dtype=torch.float64)
        numeric = torch.stack([(value(start + step) - value(start - step)) / 2e-6 for step in steps])
    assert gradient.abs().min() > 1e-3
    torch.testing.assert_close(gradient, numeric, rtol=1e-4, atol=1e-4)


def test_rotation_is_that_of_the_quaternion() -> None:
    q = np.array([0.3, -0.2, 0.5, 0.9])
    expected = se3.quaternion_to_rotation(q / np.linalg.norm(q))
    np.testing.assert_allclose(rotation_of(torch.from_numpy(q)).numpy(), expected, atol=1e-12)


def test_where_rays_are_drawn() -> None:
    """Two of 16 rows on each side are out, and a pixel without depth; at edges the 15 strongest for one ray."""
    depth = np.full((16, 24), 2.0, np.float32)
    depth[5, 5] = np.nan
    edge = np.arange(384, dtype=np.float32).reshape(16, 24)
    uniform = usable_pixels(depth, edge, PointSlamTrackerConfig(border=0.125), CAMERA)
    assert len(uniform) == 12 * 20 - 1
    strongest = usable_pixels(depth, edge, PointSlamTrackerConfig(border=0.125, pixels="edges", rays=1), CAMERA)
    assert sorted(strongest.tolist()) == list(range(13 * 24 + 7, 13 * 24 + 22))


def test_frames_are_mapped_by_their_number() -> None:
    """All of the first three, then every fifth; a frame that never came (held out) moves the next one."""
    keyframer = PointSlamKeyframer(PointSlamKeyframerConfig(first_frames=3, window=2))
    image = np.zeros((2, 2, 3), np.uint8)
    mapped = []
    for number in [k for k in range(10, 28) if k != 17]:
        decision = keyframer.update(StereoFrame(number, 0.0, image), TrackingResult(np.eye(4), "ok"))
        mapped += [number] if decision.is_keyframe else []
        assert decision.window == tuple(mapped[-2:])
    assert mapped == [10, 11, 12, 18, 23]


def mapped(keyframes: list[Keyframe], break_after: int | None = None) -> PointSlamMapper:
    mapper = started()
    for k, keyframe in enumerate(keyframes):
        if k == break_after:
            file = io.BytesIO()
            torch.save(mapper.state(), file)
            mapper = started()
            mapper.restore(torch.load(io.BytesIO(file.getvalue()), weights_only=True), iter(keyframes[:k]))
        mapper.add_keyframe(keyframe, [keyframe.frame.number])
    mapper.finish()
    return mapper


def started() -> PointSlamMapper:
    mapper = PointSlamMapper(SMALL)
    mapper.start(CAMERA, [], 3)
    return mapper


def test_a_broken_map_goes_on_to_the_same_bits() -> None:
    keyframes = [wall(k, 0.1 * k) for k in range(3)]
    whole, broken = mapped(keyframes), mapped(keyframes, break_after=2)
    assert whole.size() == broken.size() != {"points": 0}
    for name, tensor in whole._cloud.state().items():
        assert torch.equal(tensor, broken._cloud.state()[name]), name


def test_a_first_frame_without_depth_is_no_first_frame() -> None:
    """It brings no points, and the geometry decoder is trained with the next one."""
    blind = wall(0)
    blind = replace(blind, depth=DepthMap(np.full((16, 24), np.nan, np.float32), "truth"))
    mapper = started()
    before = mapper.state()["geometry"]
    assert np.isfinite(mapper.add_keyframe(blind, [0]).psnr_db)
    assert mapper.size() == {"points": 0}
    mapper.add_keyframe(wall(1), [1])
    assert mapper.size() != {"points": 0}
    assert not torch.equal(before["output_linear.weight"], mapper.state()["geometry"]["output_linear.weight"])


def test_one_thread_or_two_give_the_same_bits() -> None:
    before = torch.get_num_threads()
    clouds = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            clouds.append(mapped([wall(0), wall(1, 0.1)])._cloud)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(clouds[0].geometry, clouds[1].geometry)
    assert torch.equal(clouds[0].color, clouds[1].color)


def test_points_follow_the_pose_of_their_frame() -> None:
    mapper = mapped([wall(0), wall(1, 0.4)])
    before = mapper._cloud.positions.clone()
    moved = np.stack([np.eye(4), wall(1, 0.4).T_world_cam])
    moved[1, 1, 3] = 0.5
    mapper.update_poses(Trajectory(moved, np.arange(2), np.arange(2.0)))
    shift = (mapper._cloud.positions - before).numpy()
    np.testing.assert_allclose(
        shift[mapper._cloud.anchor == 1], [[0, 0.5, 0]] * (mapper._cloud.anchor == 1).sum(), atol=1e-6
    )
    assert not shift[mapper._cloud.anchor == 0].any()


def test_a_view_needs_its_depth_and_shows_nothing_where_no_point_is() -> None:
    mapper, keyframe = mapped([wall(0)]), wall(0)
    view = PinholeView.of(CAMERA, keyframe.T_world_cam)
    with pytest.raises(BenchError, match="with the depth of a view"):
        mapper.render(view)
    shown = mapper.render(view, keyframe.depth.depth)
    assert shown.alpha.mean() > 0.9
    assert shown.depth[shown.alpha > 0] == pytest.approx(2.0, rel=0.021)
    far = mapper.render(PinholeView.of(CAMERA, se3.compose(np.eye(3), np.full(3, 50.0))), keyframe.depth.depth)
    assert not far.alpha.any()
    assert not far.color.any()


def test_a_hole_in_the_depth_is_marched() -> None:
    """The wall is found without its depth where others tell how far to look; without marching the hole is black."""
    mapper, keyframe = mapped([wall(0)]), wall(0)
    depth = keyframe.depth.depth.copy()
    depth[6:9, 8:14] = np.nan
    view, radius = PinholeView.of(CAMERA, np.eye(4)), np.full((16, 24), 0.32, np.float32)
    assert not mapper.render(view, depth).alpha[6:9, 8:14].any()
    mapper._renderer.settings = replace(SMALL.ray, march=True)
    found = picture(mapper._renderer, view, depth, radius)
    assert found.alpha[6:9, 8:14].all()
    assert found.depth[6:9, 8:14] == pytest.approx(2.0, abs=0.3)


class Wall(Dataset):
    label, has_right = "wall", False
    camera, numbers = CAMERA, tuple(range(4))

    def frame(self, position: int) -> StereoFrame:
        return wall(position, 0.02 * position).frame

    def ground_truth(self) -> Trajectory | None:
        return Trajectory(np.stack([wall(k, 0.02 * k).T_world_cam for k in range(4)]), np.arange(4), np.arange(4.0))


def tracker_on(mapper: PointSlamMapper, dataset: Dataset) -> PointSlamTracker:
    tracker = PointSlamTracker(PointSlamTrackerConfig(iterations=3, rays=50, border=0.1))
    tracker.start(dataset)
    tracker.use_map(mapper.view())
    return tracker


def test_two_true_poses_then_constant_speed_and_steps_of_the_rate() -> None:
    dataset, mapper = Wall(), mapped([wall(0)])
    tracker = tracker_on(mapper, dataset)
    truth = dataset.ground_truth()
    assert truth is not None
    poses = [tracker.track(dataset.frame(k)).T_world_cam for k in range(2)]
    assert np.array_equal(np.stack(poses), truth.T_world_cam[:2])  # type: ignore[arg-type]
    state = tracker.state()
    third = tracker.track(dataset.frame(2))
    assert third.state == "ok"
    assert third.T_world_cam is not None
    guess_off = np.abs(third.T_world_cam[:3, 3] - truth.T_world_cam[2, :3, 3])
    assert (guess_off <= 2 * 0.002 + 1e-6).all(), "at most two steps of Adam from the guess, which is the truth here"
    again = tracker_on(mapper, dataset)
    again.restore(state)
    assert np.array_equal(again.track(dataset.frame(2)).T_world_cam, third.T_world_cam)  # type: ignore[arg-type]
    assert len(again.trajectory()) == 3


def test_without_ground_truth_the_run_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Wall, "ground_truth", lambda self: None)
    dataset = Wall()
    first = tracker_on(mapped([wall(0)]), dataset).track(dataset.frame(0))
    assert np.array_equal(first.T_world_cam, np.eye(4))  # type: ignore[arg-type]
    assert "no ground truth" in first.events[0].values["text"]


def test_what_does_not_go_together_says_so() -> None:
    mapper = mapped([wall(0)])
    view = mapper.view()
    with pytest.raises(BenchError, match="mapper=point_slam shows its map only along rays"):
        view.render(PinholeView.of(CAMERA, np.eye(4)))
    for part in (
        MonoGSTracker(MonoGSTrackerConfig()),
        MonoGSKeyframer(MonoGSKeyframerConfig()),
        SplatamTracker(SplatamTrackerConfig()),
    ):
        with pytest.raises(BenchError, match="compares whole images needs a view without it"):
            part.use_map(view)
    with pytest.raises(BenchError, match="mapper=point_slam alone can"):
        PointSlamTracker(PointSlamTrackerConfig()).use_map(object())  # type: ignore[arg-type]


def test_the_originals_geometry_decoder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensors with "coarse" in their key are taken, others left; one that is missing is told."""
    there, decoder = GeometryDecoder(random(1)), GeometryDecoder(random(2))
    content = {f"decoder.coarse.{key}": value for key, value in there.state_dict().items()}
    monkeypatch.setenv("BGS_WEIGHTS", str(tmp_path))
    (tmp_path / "nice_slam").mkdir()
    file = tmp_path / "nice_slam/middle_fine.pt"
    torch.save({"model": content | {"decoder.fine.output_linear.bias": torch.zeros(1)}}, file)
    load_geometry(decoder)
    assert all(torch.equal(value, decoder.state_dict()[key]) for key, value in there.state_dict().items())
    content.pop("decoder.coarse.embedder._B")
    torch.save({"model": content}, file)
    with pytest.raises(BenchError, match="1 missing"):
        load_geometry(decoder)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (PointSlamMapperConfig, {"window": 1}),
        (PointSlamMapperConfig, {"rays": 5, "window": 6}),
        (PointSlamMapperConfig, {"depth_range_m": (3.0, 2.0)}),
        (RadiusSettings, {"edge_m": 0.1}),
        (RaySettings, {"near": 1.1}),
        (RaySettings, {"least_neighbours": 9}),
        (PointSlamTrackerConfig, {"pixels": "corners"}),
        (PointSlamTrackerConfig, {"translation_rate": 0.0}),
        (PointSlamKeyframerConfig, {"every": 0}),
    ],
)
def test_wrong_settings_are_told(kind: type, settings: dict[str, Any]) -> None:
    with pytest.raises(BenchError):
        kind(**settings)
