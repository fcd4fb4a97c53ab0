"""The mapper on a tiny street: it learns, it repeats itself bit by bit, it follows corrected poses and prunes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.contracts.loss import LossConfig, TorchLoss
from bench.errors import BenchError
from bench.gaussians.map import SKY
from bench.gaussians.parameters import NamedParameters
from bench.gaussians.ply import read_ply
from bench.gaussians.schema import OPACITY_LOGIT
from bench.gaussians.seeding import SeedingConfig
from bench.geometry import se3
from bench.io.array_store import ArrayStore
from bench.supervision.target import Target
from bench.types import DepthMap, Keyframe, PinholeView, Trajectory
from plugins.datasets.street import Street, StreetConfig
from plugins.losses.geo import GeoConfig, GeoLoss
from plugins.losses.rgb import RgbConfig, RgbLoss
from plugins.losses.ssim import SsimConfig, SsimLoss
from plugins.mappers.gaussian import GaussianMapper, GaussianMapperConfig


@cache
def street() -> tuple[Street, list[Keyframe]]:
    """Four frames with exact depth, sky and poses."""
    dataset = Street(StreetConfig("street", frames=4, width=160, height=64))
    truth = dataset.ground_truth()
    keyframes = []
    for k in range(4):
        depth = DepthMap(dataset.true_depth(k), "truth")
        keyframes.append(Keyframe(dataset.frame(k), depth, dataset.true_sky(k), truth.T_world_cam[k]))
    return dataset, keyframes


def started(random_seed: int = 0, **settings: object) -> GaussianMapper:
    mapper = GaussianMapper(GaussianMapperConfig("gaussian", **settings))  # type: ignore[arg-type]
    losses = [RgbLoss(RgbConfig("rgb")), SsimLoss(SsimConfig("ssim")), GeoLoss(GeoConfig("geo"))]
    mapper.start(street()[0].camera, losses, random_seed)
    return mapper


def mapped(random_seed: int = 0, **settings: object) -> GaussianMapper:
    mapper = started(random_seed, **settings)
    keyframes = street()[1]
    for k, keyframe in enumerate(keyframes):
        mapper.add_keyframe(keyframe, [kf.frame.number for kf in keyframes[: k + 1]])
    mapper.finish()
    return mapper


def psnr_by_hand(mapper: GaussianMapper, keyframe: Keyframe) -> float:
    """Over all pixels and channels of the rendered view, in float64 numpy."""
    view = mapper.render(PinholeView.of(street()[0].camera, keyframe.T_world_cam))
    error = view.color.astype(np.float64) - keyframe.frame.left / 255.0
    return float(-10 * np.log10((error**2).mean()))


def saved(mapper: GaussianMapper, path: Path) -> bytes:
    mapper.save(path)
    return path.read_bytes()


def test_optimisation_beats_the_seeding() -> None:
    """A first frame's seeds alone (one iteration) show about 9 dB, pale as they are; forty bring 5 dB more."""
    keyframe = street()[1][0]
    mappers = [started(iterations=iterations) for iterations in (1, 40)]
    for mapper in mappers:
        mapper.add_keyframe(keyframe, [0])
    seeds, learned = (psnr_by_hand(mapper, keyframe) for mapper in mappers)
    assert 7.0 < seeds < learned - 5.0


@pytest.mark.slow
def test_the_whole_sequence_is_learned_and_not_only_the_newest_frame() -> None:
    assert min(psnr_by_hand(mapped(iterations=30), keyframe) for keyframe in street()[1]) > 25.0


@pytest.mark.parametrize(("older_views", "shares"), [("by_age", (1 / 8, 2 / 8, 5 / 8)), ("uniform", (1 / 3,) * 3)])
def test_what_was_not_learned_from_for_long_is_drawn_more_often(older_views: str, shares: tuple[float, ...]) -> None:
    replay, random = started(older_views=older_views)._replay, np.random.default_rng(0)
    for number, step in ((0, 10), (1, 9), (2, 6)):
        replay.learned(number, step)
    replay.forget_ages_but([0, 1, 2])
    drawn = np.bincount([replay.older([0, 1, 2], 10, random) for _ in range(4000)]) / 4000
    np.testing.assert_allclose(drawn, shares, atol=0.03)


def test_report_of_a_keyframe() -> None:
    mapper = started(iterations=3)
    keyframe = street()[1][0]
    report = mapper.add_keyframe(keyframe, [0])
    assert report.psnr_db == pytest.approx(psnr_by_hand(mapper, keyframe), abs=1e-3)
    assert mapper.size() == {"gaussians": mapper.gaussians}
    assert mapper.gaussians > 0
    assert set(report.losses) == {"rgb", "ssim", "geo"}


@pytest.mark.parametrize("sh_degree", [1, 3])
def test_harmonics_are_learned(sh_degree: int) -> None:
    mapper = mapped(iterations=6, sh_degree=sh_degree)
    harmonics = mapper._map.live.planes[14:]
    assert len(harmonics) == {1: 9, 3: 45}[sh_degree]
    assert float(harmonics.abs().mean()) > 1e-4
    assert min(psnr_by_hand(mapper, keyframe) for keyframe in street()[1]) > 18.0


def test_one_seed_gives_the_same_bytes_and_another_does_not(tmp_path: Path) -> None:
    first, again, other = (saved(mapped(seed, iterations=6), tmp_path / "map.ply") for seed in (0, 0, 1))
    assert first == again
    assert first != other


def test_depth_of_the_render_is_the_depth_of_the_street() -> None:
    """Raw depth, sum d a T, where the map is opaque; the truth is the data set's own."""
    dataset, keyframes = street()
    view = mapped(iterations=20).render(PinholeView.of(dataset.camera, keyframes[1].T_world_cam))
    truth = keyframes[1].depth.depth
    covered = (view.alpha > 0.95) & (truth < 40)
    assert covered.mean() > 0.4
    error = np.abs(view.depth[covered] / view.alpha[covered] - truth[covered]) / truth[covered]
    assert np.median(error) < 0.05


def test_prunes_what_is_nearly_transparent(tmp_path: Path) -> None:
    mapper = started(iterations=1, prune_opacity=5e-3)
    mapper.add_keyframe(street()[1][0], [0])
    before = mapper.gaussians
    logits = torch.logit(torch.tensor([0.004, 0.006]))
    mapper._map.live.planes[OPACITY_LOGIT, 3], mapper._map.live.planes[OPACITY_LOGIT, 4] = logits[0], logits[1]
    neighbours = mapper._map.live.planes[:, [2, 4]].clone()
    mapper._prune()
    assert mapper.gaussians == before - 1
    assert torch.equal(mapper._map.live.planes[:, [2, 3]], neighbours)
    mapper.add_keyframe(street()[1][1], [0, 1])  # optimizer and birth depths still fit
    mapper.save(tmp_path / "map.ply")
    assert float(NamedParameters(read_ply(tmp_path / "map.ply")[0]).opacities.min()) >= 5e-3


def test_new_seeds_only_where_the_map_does_not_explain_the_image() -> None:
    """The same frame a second time adds few; with a threshold that nothing meets, none."""
    keyframe = street()[1][0]
    for settings, most in ((SeedingConfig(margin=0.0), 0.25), (SeedingConfig(max_alpha=0.0, min_error=9.0), 0.0)):
        mapper = started(iterations=30, seeding=settings)
        mapper.add_keyframe(keyframe, [0])
        first = mapper.gaussians
        mapper._seed(0)
        assert mapper.gaussians - first <= most * first


@pytest.mark.parametrize("fill_holes", [False, True])
def test_depth_that_is_not_sure_enough_seeds_like_unknown_depth(fill_holes: bool) -> None:
    """The right half is known with confidence 0.4: above 0.3 it counts, below 0.5 it is as if it were not there."""
    keyframe = street()[1][0]
    confidence = np.ones_like(keyframe.depth.depth)
    confidence[:, 80:] = 0.4
    half = np.where(confidence == 1, keyframe.depth.depth, np.float32(np.nan))

    def seeds(depth: DepthMap, least: float) -> torch.Tensor:
        mapper = started(seeding=SeedingConfig(min_confidence=least, fill_holes=fill_holes))
        given = replace(keyframe, depth=depth)
        mapper._replay.keyframes.add(given)
        mapper._seed(0)
        return mapper._map.live.planes

    sure = DepthMap(keyframe.depth.depth, "sure", confidence)
    assert torch.equal(seeds(sure, 0.5), seeds(DepthMap(half, "half"), 0.0))
    assert torch.equal(seeds(sure, 0.3), seeds(keyframe.depth, 0.0))
    assert not torch.equal(seeds(sure, 0.5), seeds(sure, 0.3))
    with pytest.raises(BenchError, match=r"mapper\.seeding\.min_confidence=0\.5: truth gives no confidence"):
        seeds(keyframe.depth, 0.5)


def test_update_poses_moves_the_views_that_mapping_learns_from() -> None:
    """After the keyframe's pose is corrected, mapping renders from the corrected one."""
    keyframes = street()[1]
    mapper = started(iterations=1)
    mapper.add_keyframe(keyframes[0], [0])
    corrected = keyframes[0].T_world_cam.copy()
    corrected[:3, 3] += [0.3, 0.0, 0.0]
    unknown = np.eye(4)
    mapper.update_poses(Trajectory(np.stack([corrected, unknown]), np.array([0, 99]), np.array([0.0, 9.9])))
    views = []
    original = mapper._rasterizer.render
    mapper._rasterizer.render = lambda planes, view, differentiable=True: (  # type: ignore[method-assign]
        views.append(view),
        original(planes, view, differentiable),
    )[1]
    mapper._iterate(0, half=False, step="")
    np.testing.assert_allclose(views[0].T_world_cam, corrected, atol=0)


ALL_THAT_IS_LEARNED: dict[str, object] = {
    "right_images": 0.5,
    "camera_color": "affine",
    "exposure": True,
    "pose_refinement": 1e-3,
}


def test_right_images_are_learned_from_in_the_right_cameras_colours() -> None:
    """The right camera of this street is darker. Its view of frame 2, which is left out, shows what that brings."""
    dataset, keyframes = street()
    dim = [replace(k, frame=replace(k.frame, right=np.uint8(k.frame.right * 0.7))) for k in keyframes]
    view = PinholeView.of(dataset.camera, keyframes[2].T_world_cam @ dataset.camera.T_left_right)
    truth, found = dim[2].frame.right / 255, {}
    for name, settings in {
        "left alone": {},
        "colours": {"camera_color": "gain_bias"},
        "learned": {"camera_color": "gain_bias", "right_images": 0.5},
    }.items():
        mapper = started(iterations=12, **settings)
        for k in (0, 1, 3):
            mapper.add_keyframe(dim[k], [0, 1, 3])
        assert mapper.uses_right_images == (name != "left alone")
        found[name] = -10 * np.log10(((mapper.render_frame(2, True, view).color - truth) ** 2).mean())
    assert found["colours"] > found["left alone"] + 1
    assert found["learned"] > found["colours"] + 0.1


def test_right_images_that_are_not_there() -> None:
    keyframe = street()[1][0]
    with pytest.raises(BenchError, match=r"mapper\.right_images needs a right image.*mapper\.right_images=0"):
        started(right_images=0.5).add_keyframe(replace(keyframe, frame=replace(keyframe.frame, right=None)), [0])


def test_exposure_and_pose_of_a_keyframe_are_found() -> None:
    """Frame 1 comes brighter and from 3 cm and 0.3 degrees beside its pose: a map that knows both fits it better."""
    dataset, keyframes = street()
    bright = np.uint8(np.clip(keyframes[1].frame.left * 1.25, 0, 255))
    off = se3.exp(np.array([0.02, -0.02, 0.01, 0.003, 0.004, 0.0]))
    second = replace(
        keyframes[1], frame=replace(keyframes[1].frame, left=bright), T_world_cam=keyframes[1].T_world_cam @ off
    )
    reports, mappers = [], []
    for settings in ({"exposure": False}, {}, {"pose_refinement": 2e-3}):
        mappers.append(started(iterations=20, seeding=SeedingConfig(stride=2, opacity=0.5), **settings))
        mappers[-1].add_keyframe(keyframes[0], [0])
        reports.append(mappers[-1].add_keyframe(second, [0, 1]).psnr_db)
        shown = mappers[-1].render_frame(1, False, PinholeView.of(dataset.camera, second.T_world_cam)).color
        assert -10 * np.log10(((shown - bright / 255) ** 2).mean()) == pytest.approx(reports[-1], abs=1e-3)
    assert np.diff(reports).min() > 0.3
    middle = np.array([0.4, 0.4, 0.4, 1])
    np.testing.assert_allclose(mappers[-1]._appearance.colors(1, right=False) @ middle, 0.5, atol=0.03)
    left_over = se3.log(se3.inverse(keyframes[1].T_world_cam) @ mappers[-1]._replay.view(1).T_world_cam)
    assert np.linalg.norm(left_over[3:]) < 0.5 * 0.005


def test_all_that_is_learned_is_resumed_to_the_bit(tmp_path: Path) -> None:
    keyframes, whole = street()[1], mapped(iterations=4, **ALL_THAT_IS_LEARNED)
    broken, store = started(iterations=4, **ALL_THAT_IS_LEARNED), ArrayStore(tmp_path / "store")
    broken.use_store(store)
    for k in range(4):
        broken.add_keyframe(keyframes[k], list(range(k + 1)))
        torch.save(broken.state(), tmp_path / "state.pt")
        broken = started(iterations=4, **ALL_THAT_IS_LEARNED)
        broken.use_store(store)
        broken.restore(torch.load(tmp_path / "state.pt", weights_only=True), iter(keyframes[: k + 1]))
    broken.finish()
    assert saved(broken, tmp_path / "broken.ply") == saved(whole, tmp_path / "whole.ply")
    view = PinholeView.of(street()[0].camera, np.eye(4))
    assert np.array_equal(broken.render_frame(2, True, view).color, whole.render_frame(2, True, view).color)


def test_a_frame_without_depth_is_survived() -> None:
    """No seeds in the first keyframe: nothing to render yet, and the next one starts the map."""
    keyframe = street()[1][0]
    blind = DepthMap(np.full_like(keyframe.depth.depth, np.nan), "nothing")
    mapper = started(iterations=2, seeding=SeedingConfig(sky_distance_m=0.0))
    mapper.add_keyframe(Keyframe(keyframe.frame, blind, None, keyframe.T_world_cam), [0])
    assert mapper.gaussians == 0
    mapper.add_keyframe(street()[1][1], [0, 1])
    assert mapper.gaussians > 100


@dataclass(frozen=True)
class BrokenConfig(LossConfig):
    """``how`` it breaks, after ``good`` evaluations."""

    how: str = "value"
    good: int = 3


class BrokenLoss(TorchLoss):
    """A user's term that goes wrong after a while: its value, its gradient alone, or both."""

    evaluated = 0

    def loss(self, color: Tensor, depth: Tensor, alpha: Tensor, target: Target) -> Tensor:
        self.evaluated += 1
        if self.evaluated <= self.config.good:
            return alpha.mean()
        # The root has no slope at 0: its gradient is infinite, its value is 0.
        return torch.sqrt(alpha - alpha.detach()).mean() if self.config.how == "gradient" else alpha.mean() / 0.0


@pytest.mark.parametrize(
    ("how", "good", "said"),
    [
        (
            "value",
            3,
            r"keyframe 0, iteration 4 of 5 \(view of frame 0, at full resolution\): the loss term mine is inf",
        ),
        (
            "value",
            0,
            r"keyframe 0, iteration 1 of 5 \(view of frame 0, at half resolution\): the loss term mine is inf",
        ),
        (
            "gradient",
            3,
            r"keyframe 0, iteration 4 of 5 .* mine is 0, but its gradient by the rendered alpha is",
        ),
        ("value", 6, r"last optimisation, iteration 2 of 2 \(view of frame 0, at full resolution\): .* mine is inf"),
    ],
)
def test_a_loss_that_is_no_number_ends_the_run_at_its_step(how: str, good: int, said: str) -> None:
    mapper = GaussianMapper(
        GaussianMapperConfig("gaussian", iterations=5, coarse_share=0.6, final_coarse_iterations=0, final_iterations=2)
    )
    losses = [RgbLoss(RgbConfig("rgb")), BrokenLoss(BrokenConfig("mine", how=how, good=good))]
    mapper.start(street()[0].camera, losses, 0)

    def run() -> None:
        mapper.add_keyframe(street()[1][0], [0])
        mapper.finish()

    with pytest.raises(BenchError, match=said):
        run()
    assert torch.isfinite(mapper._map.live.planes).all()


def test_a_map_that_is_spoilt_between_two_keyframes_is_no_picture() -> None:
    mapper = started(iterations=1, final_iterations=0)
    mapper.add_keyframe(street()[1][0], [0])
    mapper._map.live.planes[OPACITY_LOGIT, :3] = torch.nan
    with pytest.raises(BenchError, match=r"^after the last optimisation: 3 of \d+ Gaussians are not finite\."):
        mapper.finish()


def test_the_second_seeding_adds_gaussians_to_the_keyframes_that_have_some() -> None:
    """Once, between coarse and fine iterations; Gaussians of a keyframe stay neighbours, in the order of keyframes."""
    few = {"iterations": 1, "final_coarse_iterations": 1, "final_iterations": 1, "prune_opacity": 0.0}
    settings = ({"refine_stride": 0}, {"refine_stride": 2, "refine_error": 0.0})
    once, twice = (mapped(**each, **few)._map.live for each in settings)
    assert once.anchor.unique().tolist() == twice.anchor.unique().tolist() == [SKY, 0, 1, 2, 3]
    assert (twice.anchor.diff() >= 0).all()
    pixels = int((~street()[1][3].sky[::2, ::2]).sum())
    assert pixels * 0.9 < int((twice.anchor == 3).sum() - (once.anchor == 3).sum()) < pixels * 1.3


def test_finish_and_render_without_any_keyframe() -> None:
    mapper = started()
    mapper.finish()
    view = mapper.render(PinholeView.of(street()[0].camera, np.eye(4)))
    assert view.color.shape == (64, 160, 3)
    assert not view.alpha.any()


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"iterations": 0}, "mapper.iterations=0 is too small"),
        ({"newest_share": 0.9, "window_share": 0.2}, r"newest_share \+ mapper.window_share"),
        ({"depth_range_m": (5.0, 2.0)}, r"mapper.depth_range_m=\[5.0, 2.0\] must be \[near, far\]"),
        ({"sh_degree": 4}, "mapper.sh_degree=4 must be 0 to 3"),
        ({"right_images": 1.2}, "mapper.right_images=1.2 must lie between 0 and 1"),
        ({"camera_color": "gain"}, "mapper.camera_color='gain' is not one of none, gain_bias, affine"),
        ({"pose_refinement": -1.0}, "mapper.pose_refinement=-1.0 is too small"),
        ({"second_moment_decay": 1.0}, r"mapper.second_moment_decay=1.0 must be at least 0 and below 1"),
    ],
)
def test_settings_that_make_no_sense(settings: dict[str, object], text: str) -> None:
    with pytest.raises(BenchError, match=text):
        GaussianMapper(GaussianMapperConfig("gaussian", **settings))  # type: ignore[arg-type]


def test_a_budget_in_seconds_counts_time_and_not_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a clock that goes on by half a second with each look; the first half of the time is at half resolution."""
    clock = itertools.count(0.0, 0.5)
    monkeypatch.setattr("plugins.mappers.gaussian.time.monotonic", lambda: next(clock))
    mapper, halves = started(seconds=2.0, iterations=1, coarse_share=0.5), []
    monkeypatch.setattr(mapper, "_iterate", lambda number, half, step: halves.append(half) or {})
    mapper.add_keyframe(street()[1][0], [0])
    assert halves == [True, True, False, False]
