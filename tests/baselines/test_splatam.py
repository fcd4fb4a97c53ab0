"""SplaTAM's tracker, keyframer and mapper on a tiny street with exact depth."""

from __future__ import annotations

import io
import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bench.baselines.splatam.tracking_loss import TrackingLoss
from bench.contracts.map_view import MapView
from bench.errors import BenchError
from bench.gaussians.ply import read_ply
from bench.gaussians.schema import LOG_SCALE, OPACITY_LOGIT
from bench.types import DepthMap, Float, Keyframe, PinholeView, StereoFrame, TrackingResult, Trajectory
from plugins.datasets.street import Street, StreetConfig
from plugins.keyframers.splatam import SplatamKeyframer, SplatamKeyframerConfig
from plugins.mappers.splatam import SplatamMapper, SplatamMapperConfig
from plugins.trackers.splatam import SplatamTracker, SplatamTrackerConfig


@cache
def street() -> tuple[Street, list[Keyframe]]:
    """Four frames, 5 cm apart, of 64 x 48 pixels, with poses as seen from the first."""
    dataset = Street(StreetConfig("street", frames=4, width=64, height=48, speed_m=0.05))
    poses = dataset.ground_truth().T_world_cam
    keyframes = []
    for k in range(4):
        depth = DepthMap(dataset.true_depth(k), "truth")
        frame = replace(dataset.frame(k), depth=depth)
        keyframes.append(Keyframe(frame, depth, dataset.true_sky(k), np.linalg.inv(poses[0]) @ poses[k]))
    return dataset, keyframes


def mapper_of(**settings: Any) -> SplatamMapper:
    mapper = SplatamMapper(SplatamMapperConfig("splatam", **{"iterations": 4, **settings}))
    mapper.start(street()[0].camera, [], 0)
    return mapper


def planes_after(mapper: SplatamMapper, folder: Path, *keyframes: int) -> torch.Tensor:
    for k in keyframes:
        mapper.add_keyframe(street()[1][k], range(k + 1))
    mapper.save(folder / "map.ply")
    return read_ply(folder / "map.ply")[0]


def through_a_file(state: Any) -> Any:
    file = io.BytesIO()
    torch.save(state, file)
    return torch.load(io.BytesIO(file.getvalue()), weights_only=True)


def test_the_first_frame_is_a_gaussian_for_each_pixel_of_known_depth(tmp_path: Path) -> None:
    keyframe = street()[1][0]
    depth, sky = keyframe.depth.depth, keyframe.sky
    assert sky is not None
    planes = planes_after(mapper_of(iterations=0, max_depth_m=30.0), tmp_path, 0)
    assert planes.shape == (14, int(((depth <= 30) & ~sky).sum()))


def test_steps_0_and_20_change_nothing(tmp_path: Path) -> None:
    """Nothing is to be pruned: the 1st and the 21st step leave the map as it was, the 2nd and the 22nd do not."""
    maps = [planes_after(mapper_of(iterations=n), tmp_path, 0) for n in (0, 1, 2, 20, 21, 22)]
    changed = [not torch.equal(before, after) for before, after in itertools.pairwise(maps)]
    assert changed == [False, True, True, False, True]


def test_large_and_transparent_gaussians_go(tmp_path: Path) -> None:
    """The largest depth is below 120 m, so that a tenth of a third of it is less than 4 m."""
    mapper = mapper_of(iterations=1, max_depth_m=120.0)
    count = planes_after(mapper, tmp_path, 0).shape[1]
    state = mapper.state()
    state["map"]["planes"][LOG_SCALE, 3] = torch.tensor([0.01, 5.0, 0.01]).log()
    state["map"]["planes"][OPACITY_LOGIT, 7] = float(np.log(0.0049 / 0.9951))
    state["map"]["planes"][OPACITY_LOGIT, 8] = float(np.log(0.0051 / 0.9949))
    mapper.restore(state, street()[1][:1])
    report = mapper.add_keyframe(street()[1][0], [0])
    assert report.events[0].kind == "pruned"
    assert report.events[0].values["count"] == 2
    assert mapper.size()["gaussians"] >= count - 2


@pytest.mark.parametrize("isotropic", [True, False])
def test_balls_stay_balls(isotropic: bool, tmp_path: Path) -> None:
    scales = planes_after(mapper_of(isotropic=isotropic), tmp_path, 0, 1)[LOG_SCALE]
    assert bool((scales == scales[0]).all()) is isotropic


def test_a_resumed_map_is_the_same_to_the_bit(tmp_path: Path) -> None:
    unbroken = mapper_of(iterations=3)
    planes_after(unbroken, tmp_path, 0, 1)
    state = through_a_file(unbroken.state())
    resumed = mapper_of(iterations=3)
    resumed.restore(state, street()[1][:2])
    assert torch.equal(*(planes_after(each, tmp_path, 2, 3) for each in (unbroken, resumed)))


def test_frames_that_leave_the_window_are_forgotten() -> None:
    mapper = mapper_of(iterations=0)
    for number, window in ((0, [0]), (1, [0, 1]), (2, [0, 2]), (3, [0, 2, 3])):
        mapper.add_keyframe(street()[1][number], window)
    assert list(mapper.state()["kept"]) == [0, 2, 3]


def test_a_corrected_pose_moves_the_map(tmp_path: Path) -> None:
    mapper, lifted = mapper_of(iterations=0), np.eye(4)
    before = planes_after(mapper, tmp_path, 0)
    lifted[1, 3] = -2.0
    mapper.update_poses(Trajectory(lifted[None], np.array([0]), np.zeros(1)))
    np.testing.assert_allclose((planes_after(mapper, tmp_path) - before)[1], -2.0, atol=1e-5)
    np.testing.assert_array_equal(mapper.state()["kept"][0], lifted)


def test_rhythm_of_keyframes_and_its_window() -> None:
    keyframer = SplatamKeyframer(SplatamKeyframerConfig("splatam", map_every=2, keyframe_every=4))
    blank, seen = np.zeros((1, 1, 3), np.uint8), []
    for number in range(10, 19):
        if number == 15:
            resumed = SplatamKeyframer(keyframer._config)
            resumed.restore(through_a_file(keyframer.state()))
            keyframer = resumed
        seen.append(keyframer.update(StereoFrame(number, 0.0, blank), TrackingResult(np.eye(4), "ok")))
    mapped = [number for number, decision in enumerate(seen, 10) if decision.is_keyframe]
    assert mapped == [10, 11, 13, 15, 17]
    assert seen[3].window == (10, 13)  # the fourth frame, which is kept
    assert seen[5].window == (10, 13, 15)
    assert seen[7].window == (10, 13, 17)


class Bowl(MapView):
    """A map whose loss is lowest where the camera is at ``place``, whatever the images are."""

    def __init__(self, place: Float) -> None:
        self.place, self.asked = place, []

    def render(self, view: PinholeView) -> Any:
        raise AssertionError("trackers need gradients")

    seen = median_depth = render

    def differentiate(self, view: PinholeView, loss: Any) -> tuple[float, Float]:
        loss.pixels, loss.depth_loss = 1, 3.0
        off = view.T_cam_world[:3, 3] + self.place
        self.asked.append(off)
        return float(np.round(np.abs(off).sum(), 6)), np.append(np.sign(off), np.zeros(3))


def tracker_of(view: MapView, **settings: Any) -> SplatamTracker:
    tracker = SplatamTracker(SplatamTrackerConfig("splatam", **{"iterations": 5, **settings}))
    tracker.start(street()[0])
    tracker.use_map(view)
    return tracker


def test_the_step_from_the_lowest_loss_is_kept() -> None:
    """Steps of 0.1 m lead to 0.1, 0.2 and 0.3 m; the loss at 0.3 m is as low as at 0.2 m, and the first one counts."""
    tracker = tracker_of(Bowl(np.full(3, 0.25)), translation_rate=0.1, rotation_rate=0.0, iterations=4)
    poses = [tracker.track(keyframe.frame).T_world_cam for keyframe in street()[1][:2]]
    np.testing.assert_array_equal(poses[0], np.eye(4))
    np.testing.assert_allclose(poses[1][:3, 3], 0.3, atol=1e-8)


@pytest.mark.parametrize(("retry_loss", "steps"), [(0.0, 5), (3.0, 10), (3.1, 5)])
def test_a_frame_that_fits_badly_gets_as_many_steps_again(retry_loss: float, steps: int) -> None:
    view = Bowl(np.ones(3))
    tracker = tracker_of(view, retry_loss=retry_loss)
    for keyframe in street()[1][:2]:
        tracker.track(keyframe.frame)
    assert len(view.asked) == steps


def test_a_frame_without_known_depth_stays_at_its_prediction() -> None:
    mapper = mapper_of()
    tracker, frames = tracker_of(mapper.view()), [keyframe.frame for keyframe in street()[1]]
    mapper.add_keyframe(street()[1][0], [0])
    assert tracker.track(frames[0]).state == "ok"
    blind = DepthMap(np.full((48, 64), np.nan, np.float32), "none")
    result = tracker.track(replace(frames[1], depth=blind))
    assert (result.state, result.inliers) == ("predicted", 0)
    np.testing.assert_array_equal(result.T_world_cam, np.eye(4))


def test_tracking_goes_downhill_and_is_resumed_to_the_bit() -> None:
    mapper, keyframes = mapper_of(iterations=8), street()[1]
    mapper.add_keyframe(keyframes[0], [0])
    tracker, frame = tracker_of(mapper.view()), keyframes[1].frame
    tracker.track(keyframes[0].frame)
    found = tracker.track(frame).T_world_cam
    loss, camera = TrackingLoss(frame.left, keyframes[1].depth.depth, 0.99, 1.0, 0.5), street()[0].camera
    here, before = (mapper.view().differentiate(PinholeView.of(camera, T), loss)[0] for T in (found, np.eye(4)))
    assert here < before
    again = tracker_of(mapper.view())
    again.restore(through_a_file(tracker.state()))
    first, second = (each.track(keyframes[2].frame).T_world_cam for each in (tracker, again))
    np.testing.assert_array_equal(first, second)
    for one, other in zip(vars(tracker.trajectory()).values(), vars(again.trajectory()).values(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("config", "settings", "told"),
    [
        (SplatamTrackerConfig, {"iterations": 0}, r"tracker\.iterations=0"),
        (SplatamTrackerConfig, {"max_depth_m": 0.0}, r"tracker\.max_depth_m=0\.0 must be above 0"),
        (SplatamMapperConfig, {"window": 1}, r"mapper\.window=1"),
        (SplatamMapperConfig, {"scene_radius_depth_ratio": 0.0}, "must be above 0"),
        (SplatamKeyframerConfig, {"map_every": 0}, r"keyframer\.map_every=0"),
    ],
)
def test_settings_out_of_range(config: Any, settings: dict[str, Any], told: str) -> None:
    with pytest.raises(BenchError, match=told):
        config("splatam", **settings)
