"""The map follows corrected keyframes: moved rigidly, each Gaussian with the keyframe that seeded it."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from test_gaussian_mapper import mapped, started, street

from bench.authoring.random_scenes import SceneSpec, random_scene
from bench.errors import BenchError
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.gaussians.parameters import NamedParameters
from bench.gaussians.ply import read_ply
from bench.gaussians.schema import COLOR, OPACITY_LOGIT
from bench.registry import PluginConfig
from bench.types import Float, PinholeView, RenderedView, Trajectory
from plugins.mappers.gaussian import GaussianMapper, GaussianMapperConfig
from plugins.rasterizers.cpu import CpuRasterizer


def axis_turn(axis: tuple[float, float, float], degrees: float, shift: tuple[float, float, float]) -> Float:
    """A rigid motion (4, 4) by Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K, angle = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.deg2rad(degrees)
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    T[:3, 3] = shift
    return T


GENERAL = axis_turn((0.3, 0.9, -0.2), 34.0, (5.0, -1.0, 2.5))

NO_SKY = replace(GaussianMapperConfig("gaussian").seeding, sky_distance_m=0)  # it would stay where it is


def trajectory(moved: dict[int, Float], absent: tuple[int, ...] = ()) -> Trajectory:
    """The street's four poses, some of them moved by a motion of the world."""
    numbers = [k for k in range(4) if k not in absent]
    poses = [moved.get(k, np.eye(4)) @ street()[1][k].T_world_cam for k in numbers]
    return Trajectory(np.stack(poses), np.array(numbers), np.array(numbers, dtype=np.float64))


def seeded(**settings: object) -> tuple[GaussianMapper, list[slice]]:
    """Four keyframes with one iteration each and nothing pruned; and which Gaussians each of them brought."""
    mapper, ranges = started(iterations=1, prune_opacity=0.0, seeding=NO_SKY, **settings), []
    for k, keyframe in enumerate(street()[1]):
        before = mapper.gaussians
        mapper.add_keyframe(keyframe, list(range(k + 1)))
        ranges.append(slice(before, mapper.gaussians))
    return mapper, ranges


def rotations(q: Float) -> Float:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) w, x, y, z of any length, by the textbook formula."""
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def in_ply(mapper: GaussianMapper, folder: Path) -> tuple[Float, Float]:
    """Means (N, 3) and rotation matrices (N, 3, 3) of the saved map."""
    mapper.save(folder / "map.ply")
    named = NamedParameters(read_ply(folder / "map.ply")[0])
    return named.means.numpy().astype(np.float64), rotations(named.quaternions.numpy().astype(np.float64))


def seen(mapper: GaussianMapper, poses: Trajectory) -> list[RenderedView]:
    return [mapper.render(PinholeView.of(street()[0].camera, T)) for T in poses.T_world_cam]


def test_a_world_that_moves_as_a_whole_looks_the_same() -> None:
    mapper = mapped(iterations=12, seeding=NO_SKY)
    before = seen(mapper, trajectory({}))
    moved = trajectory(dict.fromkeys(range(4), GENERAL))
    mapper.update_poses(moved)
    for old, new in zip(before, seen(mapper, moved), strict=True):
        # Single pixels may differ where the alpha threshold of 1/255 falls the other way.
        for attribute, scale in (("color", 1.0), ("depth", 20.0), ("alpha", 1.0)):
            difference = np.abs(getattr(old, attribute) - getattr(new, attribute)) / scale
            assert np.quantile(difference, 0.999) < 1e-3
            assert np.median(difference) < 1e-5


@pytest.mark.parametrize("sh_degree", [1, 2, 3])
def test_harmonics_turn_with_their_keyframe(sh_degree: int) -> None:
    """A turned map from a turned camera looks as before, which it does not if its harmonics stay."""
    planes, view = random_scene(SceneSpec(1, 60, 48, 30, 2.0, (0.1, 0.9)))
    random = torch.Generator().manual_seed(0)
    harmonics = 0.1 * torch.randn(3 * ((sh_degree + 1) ** 2 - 1), 60, generator=random)
    gaussians = GaussianMap(sh_degree, torch.device("cpu"))
    gaussians.add(0, view.T_world_cam, torch.cat([planes, harmonics]), torch.ones(60))
    sight = GaussianMapView(gaussians, CpuRasterizer(PluginConfig("cpu")))
    before = sight.render(view).color
    turned = replace(view, T_world_cam=GENERAL @ view.T_world_cam)
    gaussians.follow(Trajectory(turned.T_world_cam[None], np.array([0]), np.zeros(1)), 0.0, 0.0)
    difference = np.abs(sight.render(turned).color - before)
    assert np.quantile(difference, 0.999) < 1e-3
    assert np.median(difference) < 1e-5
    gaussians.planes[14:] = harmonics
    assert np.quantile(np.abs(sight.render(turned).color - before), 0.999) > 0.01


def test_only_the_gaussians_of_moved_keyframes_move(tmp_path: Path) -> None:
    mapper, ranges = seeded()
    assert all(r.stop > r.start for r in ranges)
    means, R = in_ply(mapper, tmp_path)
    mapper.update_poses(trajectory({1: GENERAL, 3: np.linalg.inv(GENERAL)}))
    new_means, new_R = in_ply(mapper, tmp_path)
    for k, motion in enumerate((np.eye(4), GENERAL, np.eye(4), np.linalg.inv(GENERAL))):
        expected = means[ranges[k]] @ motion[:3, :3].T + motion[:3, 3]
        np.testing.assert_allclose(new_means[ranges[k]], expected, rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(new_R[ranges[k]], motion[:3, :3] @ R[ranges[k]], atol=2e-6)
        if k in (0, 2):
            np.testing.assert_array_equal(new_means[ranges[k]], means[ranges[k]])
            np.testing.assert_array_equal(new_R[ranges[k]], R[ranges[k]])


def test_pruning_does_not_mix_up_whose_gaussians_they_are(tmp_path: Path) -> None:
    mapper, ranges = seeded()
    mapper.config = replace(mapper.config, prune_opacity=5e-3)
    random = np.random.default_rng(3)
    mapper._map.live.planes[COLOR] = 0.0
    mapper._map.live.planes[COLOR, ranges[2]] = 0.7
    doomed = random.choice(mapper.gaussians, mapper.gaussians // 3, replace=False)
    mapper._map.live.planes[OPACITY_LOGIT], mapper._map.live.planes[OPACITY_LOGIT, doomed] = 0.0, -9.0
    mapper._prune()
    of_second = mapper._map.live.planes[COLOR.start].numpy() > 0.5
    assert 0 < of_second.sum() < ranges[2].stop - ranges[2].start
    means, _ = in_ply(mapper, tmp_path)
    mapper.update_poses(trajectory({2: axis_turn((0, 1, 0), 0.0, (0.5, 0.0, 0.0))}))
    new_means, _ = in_ply(mapper, tmp_path)
    np.testing.assert_allclose((new_means - means)[:, 0], np.where(of_second, 0.5, 0.0), atol=1e-5)


def test_learning_continues_as_if_nothing_had_moved() -> None:
    """A half turn about y maps axes to axes, for which Adam is blind: learning after it must do what it did before."""
    half_turn = axis_turn((0, 1, 0), 180.0, (3.0, 0.0, -2.0))
    stayed, went = (mapped(iterations=10, final_iterations=0, seeding=NO_SKY) for _ in range(2))
    moved = trajectory(dict.fromkeys(range(4), half_turn))
    went.update_poses(moved)
    start = seen(stayed, trajectory({}))
    for mapper in (stayed, went):
        for k in (3, 1, 2, 0, 3, 2):
            mapper._iterate(k, half=False, step="")
    for first, old, new in zip(start, seen(stayed, trajectory({})), seen(went, moved), strict=True):
        learned, difference = np.abs(old.color - first.color).mean(), np.abs(old.color - new.color).mean()
        assert difference < 0.02 * learned


def test_small_corrections_add_up_until_the_map_follows(tmp_path: Path) -> None:
    mapper, ranges = seeded(follow_corrections_m=0.1, follow_corrections_deg=0.5)
    means, _ = in_ply(mapper, tmp_path)
    for shift, followed in ((0.06, 0.0), (0.09, 0.0), (0.12, 0.12), (0.2, 0.12), (0.23, 0.23)):
        mapper.update_poses(trajectory({1: axis_turn((0, 1, 0), 0.0, (shift, 0.0, 0.0))}))
        new_means, _ = in_ply(mapper, tmp_path)
        np.testing.assert_allclose((new_means - means)[ranges[1], 0], followed, atol=2e-5)
        np.testing.assert_array_equal(new_means[ranges[0]], means[ranges[0]])
    in_place = street()[1][2].T_world_cam
    about_camera = in_place @ axis_turn((0, 0, 1), 0.6, (0.0, 0.0, 0.0)) @ np.linalg.inv(in_place)
    mapper.update_poses(trajectory({2: about_camera}))
    assert np.abs(in_ply(mapper, tmp_path)[0] - means)[ranges[2]].max() > 0.01


def test_a_keyframe_that_is_lost_stays_and_an_event_tells_what_moved(tmp_path: Path) -> None:
    mapper, ranges = seeded()
    means, _ = in_ply(mapper, tmp_path)
    sideways = axis_turn((0, 1, 0), 0.0, (0.25, 0.0, 0.0))
    mapper.update_poses(trajectory(dict.fromkeys(range(4), sideways), absent=(1,)))
    new_means, _ = in_ply(mapper, tmp_path)
    np.testing.assert_array_equal(new_means[ranges[1]], means[ranges[1]])
    moved = mapper.gaussians - (ranges[1].stop - ranges[1].start)
    (event,) = next(mapper.final_steps())
    assert (event.kind, event.frame) == ("map_moved", 3)
    assert (event.values["keyframes"], event.values["gaussians"]) == (3, moved)
    assert event.values["largest_m"] == pytest.approx(0.25)
    assert event.values["largest_deg"] == pytest.approx(0, abs=1e-4)
    mapper.update_poses(trajectory(dict.fromkeys(range(4), sideways), absent=(1,)))
    assert next(mapper.final_steps()) == ()


def test_right_images_do_not_stay_in_memory() -> None:
    keyframe = street()[1][0]
    right = keyframe.frame.right.copy()
    alive = weakref.ref(right)
    mapper = started(iterations=1)
    mapper.add_keyframe(replace(keyframe, frame=replace(keyframe.frame, right=right)), [0])
    del right
    gc.collect()
    assert alive() is None


@pytest.mark.parametrize("setting", ["follow_corrections_m", "follow_corrections_deg", "live_keyframes"])
def test_settings_below_their_least(setting: str) -> None:
    with pytest.raises(BenchError, match=f"mapper.{setting}"):
        GaussianMapper(GaussianMapperConfig("gaussian", **{setting: -1}))
