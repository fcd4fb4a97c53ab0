"""Frames without a right image: what can do without runs, and what can't says so in a sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.authoring.check import check_plugin
from bench.authoring.verdict import failures
from bench.config import compose_run
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.registry import lookup, register
from bench.slam.run import run_system
from bench.types import Map, StereoFrame
from plugins.datasets.street import Street, StreetConfig

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


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["tracker=groundtruth", "stereo=sgbm"], "stereo backbone Sgbm needs right images, and street/0 has none"),
        (
            ["tracker=stereo_orb", "stereo=lidar"],
            "tracker=stereo_orb needs right images, .* Choose tracker=groundtruth",
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
