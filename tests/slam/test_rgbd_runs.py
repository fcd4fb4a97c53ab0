"""Frames without a right image: what can do without runs, and what can't says so in a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from killed_run import killed_after

from bench.authoring.check import check_plugin
from bench.authoring.verdict import failures
from bench.config import compose_run
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.registry import PluginConfig, lookup, register
from bench.slam.run import run_system
from bench.types import DepthMap, Keyframe, Map, MappingReport, StereoCamera, StereoFrame, TrackingResult
from plugins.datasets.street import Street, StreetConfig
from plugins.mappers.gaussian import GaussianMapper
from plugins.stereo.sensor import Sensor
from plugins.trackers.groundtruth import GroundTruth, GroundTruthConfig

SETTINGS = ("dataset=rgbd_for_tests", "dataset.frames=4", "dataset.width=320", "dataset.height=96")
SETTINGS += (
    "mapper.iterations=3",
    "mapper.final_coarse_iterations=1",
    "mapper.final_iterations=1",
    "protocol.lpips=false",
)


@register("dataset", "rgbd_for_tests", config=StreetConfig)
class Rgbd(Street):
    """The street as a camera with a depth sensor sees it."""

    has_right = False

    def frame(self, position: int) -> StereoFrame:
        return replace(super().frame(position), right=None)

    def lidar_depth(self, position: int) -> Map | None:
        return self.true_depth(position)


def run(output: Path, *overrides: str) -> Path:
    return run_system(compose_run([*SETTINGS, f"output={output}", *overrides])).path


@pytest.mark.slow
def test_depth_from_the_data_set_runs_to_the_end_like_the_pair(tmp_path: Path) -> None:
    """The same map as of pairs with the same depth and poses, since mapping looks at no right image."""
    options = ("tracker=groundtruth", "stereo=lidar")
    folder = run(tmp_path / "rgbd", *options)
    assert (folder / "views/left/color/000003.png").is_file()
    assert not (folder / "views/right").exists()
    metrics = evaluate_run(folder)
    assert metrics["views"]["left"]["n"] == 4
    assert "right" not in metrics["views"]
    assert "no right images" in metrics["notes"]["right"]
    depth = lookup("dataset", "street").cls.true_depth
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Street, "lidar_depth", depth)
        pairs = run(tmp_path / "pairs", "dataset=street", *options)
    assert (folder / "map.ply").read_bytes() == (pairs / "map.ply").read_bytes()
    assert (pairs / "views/right/color/000003.png").is_file()


def test_a_data_set_without_right_images_passes_its_checks() -> None:
    assert failures(check_plugin("dataset=rgbd_for_tests", *SETTINGS[1:4], "tracker=groundtruth")) == []


@register("tracker", "deep_for_tests", config=GroundTruthConfig)
class Deep(GroundTruth):
    """Notes the depth that it is given with each frame."""

    uses_depth = True
    given: ClassVar[list[DepthMap | None]] = []

    def track(self, frame: StereoFrame) -> TrackingResult:
        self.given.append(frame.depth)
        return super().track(frame)


@register("stereo", "fading_for_tests", config=PluginConfig)
class Fading(Sensor):
    """A sensor that says a hundredth more with each frame that it is asked for; the held-out frame knows none."""

    temporal = True

    def start(self, dataset: Dataset) -> None:
        super().start(dataset)
        self._asked = 0

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        self._asked += 1
        depth = super().depth(frame, position, camera).depth
        return DepthMap(depth * np.float32(np.nan if frame.number == 2 else 1 + 0.01 * self._asked), "fading")


@pytest.mark.slow
def test_a_tracker_that_uses_depth_gets_that_of_every_frame_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a held-out frame; a keyframe's is the same, also in a run that is killed and resumed."""
    options = ("dataset.frames=5", "dataset.width=128", "dataset.height=64", "protocol.holdout_every=3")
    options += ("tracker=deep_for_tests", "stereo=fading_for_tests", "checkpoint_s=0", "mapper.final_iterations=0")
    made: list[Keyframe] = []
    add = GaussianMapper.add_keyframe

    def spy(mapper: GaussianMapper, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        made.append(keyframe)
        return add(mapper, keyframe, window)

    monkeypatch.setattr(GaussianMapper, "add_keyframe", spy)
    monkeypatch.setattr(Deep, "given", [])
    whole = run(tmp_path / "whole", *options)
    street = Street(StreetConfig(frames=5, width=128, height=64))
    for position, depth in enumerate(Deep.given):
        assert depth is not None
        factor = np.float32(np.nan if position == 2 else 1 + 0.01 * (position + 1))
        np.testing.assert_array_equal(depth.depth, street.true_depth(position) * factor)
    assert [keyframe.frame.number for keyframe in made] == [0, 1, 3, 4]
    assert all(keyframe.depth is Deep.given[keyframe.frame.number] for keyframe in made)
    frames = pd.read_csv(whole / "frames.csv")
    assert frames.heldout.tolist() == [False, False, True, False, False]
    assert (frames.stereo_s > 0).all()
    with killed_after(4, monkeypatch):
        run(tmp_path / "killed", *options)
    assert (run(tmp_path / "killed", *options) / "map.ply").read_bytes() == (whole / "map.ply").read_bytes()


def test_what_uses_depth_passes_the_checks_of_a_tracker() -> None:
    assert failures(check_plugin("tracker=deep_for_tests", *SETTINGS[:4], "dataset=street")) == []


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["tracker=groundtruth", "stereo=sgbm"], "stereo backbone Sgbm needs right images, and street/0 has none"),
        (
            ["tracker=stereo_orb", "stereo=lidar"],
            "tracker=stereo_orb needs right images, .* such as tracker=splatam",
        ),
        (
            ["tracker=groundtruth", "stereo=lidar", "mapper.right_images=0.5"],
            "mapper=gaussian is set to use right images, and street/0 has none",
        ),
    ],
)
def test_who_needs_right_images_says_so_before_anything_is_written(
    tmp_path: Path, overrides: list[str], message: str
) -> None:
    with pytest.raises(BenchError, match=message):
        run(tmp_path / "run", *overrides)
    assert not (tmp_path / "run").exists()


def test_one_frame_without_a_right_image_is_named() -> None:
    with pytest.raises(BenchError, match=r"mine needs a right image, and frame 7 has none\. Choose yours\."):
        StereoFrame(7, 0.7, np.zeros((2, 2, 3), np.uint8)).pair("mine", "yours")
