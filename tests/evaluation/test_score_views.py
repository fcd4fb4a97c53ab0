"""Scoring on several cores, a scoring that is stopped and goes on, and one of thousands of frames."""

from __future__ import annotations

import math
import os
import time
import tracemalloc
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.contracts.saved_run import SavedView
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.evaluation.score import score_pair
from bench.evaluation.scores_file import ScoresFile, read_scores
from bench.evaluation.trajectory_pair import TrajectoryPair
from bench.registry import PluginConfig, register
from bench.runs.folder import RunFolder, picture_path
from bench.types import Map, StereoCamera, StereoFrame, Trajectory
from plugins.evaluators.image_quality import ImageEvaluator
from tests.evaluation.tiny_run import LOST, NUMBERS, TinyDataset, frame_row, straight_drive, write_tiny_run

RESULTS = ("metrics.json", "per_frame.csv")
SCORED = [number for number in NUMBERS if number != LOST]


def results(run: Path) -> list[bytes]:
    return [(run / name).read_bytes() for name in RESULTS]


def stop_after(frames: int) -> Callable[[str, int, int], None]:
    def show(what: str, done: int, total: int) -> None:
        if done == frames:
            raise KeyboardInterrupt

    return show


@pytest.fixture
def tiny_config(tiny_config: dict[str, Any]) -> dict[str, Any]:
    """With evaluators of pictures alone."""
    return tiny_config | {"evaluator": {name: {"name": name} for name in ("image", "depth_l1")}}


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the frames whose left images are scored from now on."""
    numbers: list[int] = []
    view = ImageEvaluator.view

    def noting(self: ImageEvaluator, of: SavedView) -> dict[str, Any] | None:
        if of.camera == "left":
            numbers.append(of.number)
        return view(self, of)

    monkeypatch.setattr(ImageEvaluator, "view", noting)
    return numbers


@pytest.mark.slow
def test_numbers_do_not_depend_on_the_number_of_workers(
    tmp_path: Path, tiny_config: dict[str, Any], weights_root: Path
) -> None:
    tiny_config["protocol"] |= {"lpips": True, "lpips_weights": str(weights_root / "lpips" / "alex_features.npz")}
    tiny_config["evaluator"] |= {name: {"name": name} for name in ("regions", "dialects")}
    found = []
    for workers in (1, 2, 3):
        run = write_tiny_run(tmp_path / str(workers), tiny_config | {"threads": workers})
        evaluate_run(run)
        found.append(results(run))
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("done", [1, 3])
def test_a_scoring_that_was_stopped_goes_on(tiny_run: Path, done: int, seen: list[int]) -> None:
    """Of the frames that were scored three are scored again, to see that all is as it was."""
    evaluate_run(tiny_run)
    whole = results(tiny_run)
    assert not (tiny_run / "scores.jsonl").exists()
    with pytest.raises(KeyboardInterrupt):
        evaluate_run(tiny_run, stop_after(done))
    seen.clear()
    steps: list[int] = []
    evaluate_run(tiny_run, lambda what, done, total: steps.append(done))
    assert results(tiny_run) == whole
    assert steps == list(range(done, len(SCORED) + 1))
    assert sorted(seen) == sorted(SCORED)
    assert not (tiny_run / "scores.jsonl").exists()


def stopped(run: Path) -> Path:
    """With the scores of all its frames but no metrics, which is where a kill may come too."""
    with pytest.raises(KeyboardInterrupt):
        evaluate_run(run, stop_after(len(SCORED)))
    return run / "scores.jsonl"


def test_scores_of_other_pictures_are_not_taken(tiny_run: Path, seen: list[int]) -> None:
    evaluate_run(tiny_run)
    before = results(tiny_run)
    stopped(tiny_run)
    other, path = (picture_path(tiny_run, "left", "color", number) for number in (11, 14))
    path.write_bytes(other.read_bytes())
    seen.clear()
    evaluate_run(tiny_run)
    assert sorted(seen) == [10, 11, 13, 14], "10, 11, 13 as those looked at again"
    of_stopped = results(tiny_run)
    assert of_stopped != before
    evaluate_run(tiny_run)
    assert results(tiny_run) == of_stopped


def test_scores_under_other_settings_are_not_taken(tmp_path: Path, tiny_config: dict[str, Any]) -> None:
    """A protocol, frames, an evaluator's settings: each makes the first line another one."""
    lines = set()
    for changes in ({}, {"ssim": "3dgs"}, {"depth_min_m": 11.0}):
        config = tiny_config | {"protocol": tiny_config["protocol"] | changes}
        lines.add(stopped(write_tiny_run(tmp_path / str(len(lines)), config)).read_bytes().split(b"\n")[0])
    tiny_config["evaluator"]["regions"] = {"name": "regions", "edges_m": [0, 5]}
    run = write_tiny_run(tmp_path / "other", tiny_config)
    lines.add(stopped(run).read_bytes().split(b"\n")[0])
    (run / "frames.csv").write_text((run / "frames.csv").read_text().replace("True", "False", 1))
    lines.add(stopped(run).read_bytes().split(b"\n")[0])
    assert len(lines) == 5


def test_scores_that_come_out_otherwise_now_are_not_taken(tiny_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A LiDAR that has changed since: nothing in the run folder and its settings says so."""
    stopped(tiny_run)

    def nearer(self: TinyDataset, position: int) -> Map:
        return np.full((40, 56), 11.0, np.float32)

    monkeypatch.setattr(TinyDataset, "lidar_depth", nearer)
    assert evaluate_run(tiny_run)["views"]["train"]["depth_l1_cm"] == pytest.approx(100.0)


@pytest.mark.parametrize("damage", ["cut", "digit"])
def test_a_damaged_line_and_what_follows_is_scored_again(tiny_run: Path, damage: str, seen: list[int]) -> None:
    evaluate_run(tiny_run)
    whole = results(tiny_run)
    path = stopped(tiny_run)
    lines = path.read_bytes().splitlines(keepends=True)
    assert len(lines) == 1 + len(SCORED)
    lines[3] = lines[3][:-9] if damage == "cut" else lines[3].replace(b"1", b"2", 2)
    path.write_bytes(b"".join(lines[: 4 if damage == "cut" else 5]))
    seen.clear()
    evaluate_run(tiny_run)
    assert results(tiny_run) == whole


def test_a_full_disk_is_told_and_what_was_written_stays(tmp_path: Path) -> None:
    file = ScoresFile(tmp_path / "scores.jsonl", "same", [(1, [], {"psnr": float("inf")})])

    class Full:
        def write(self, content: bytes) -> int:
            return len(content) - 1

    whole, file._file = file._file, Full()  # type: ignore[assignment]
    with pytest.raises(BenchError, match=r"scores\.jsonl: No space left on device\. Make room and score again"):
        file.append((2, [], {}))
    whole.close()
    assert read_scores(tmp_path / "scores.jsonl", "same") == {1: (1, [], {"psnr": float("inf")})}
    assert read_scores(tmp_path / "scores.jsonl", "other") == {}


@dataclass(frozen=True)
class LongConfig(PluginConfig):
    frames: int = 0
    """How many."""


@register("dataset", "long_for_tests", config=LongConfig)
class LongDataset(TinyDataset):
    """Frames of 16x12 pixels, all the same, with LiDAR at 12 m; counts those whose images are in memory."""

    camera = StereoCamera(16, 12, 50.0, 50.0, 7.5, 5.5, (0.5, 0.0, 0.0))
    image = np.random.default_rng(0).integers(0, 200, (12, 16, 3), dtype=np.uint8)
    most_alive = 0

    def __init__(self, config: LongConfig) -> None:
        self.numbers = tuple(range(config.frames))
        self._images: list[weakref.ref[Any]] = []
        LongDataset.most_alive = 0

    def frame(self, position: int) -> StereoFrame:
        frame = StereoFrame(position, 0.1 * position, self.image.copy(), self.image.copy())
        self._images.append(weakref.ref(frame.left))
        alive = sum(image() is not None for image in self._images)
        LongDataset.most_alive = max(LongDataset.most_alive, alive)
        return frame

    def lidar_depth(self, position: int) -> Map | None:
        return np.full((12, 16), 12.0, np.float32)


def write_long_run(path: Path, config: dict[str, Any], frames: int) -> Path:
    """All renders are links to one picture, all depth maps to another one."""
    config |= {"dataset": {"name": "long_for_tests", "frames": frames}}
    config |= {"protocol": {"lpips": False, "right_view": False}}
    folder = RunFolder.create(path, config, "hash", rerun=False)
    pictures = {"color": LongDataset.image[..., ::-1] + np.uint8(4), "depth": np.full((12, 16), 2560, np.uint16)}
    for what, picture in pictures.items():
        picture_path(path, "left", what, 0).parent.mkdir(parents=True)
        cv2.imwrite(str(path / f"{what}.png"), picture)
        for number in range(frames):
            os.link(path / f"{what}.png", picture_path(path, "left", what, number))
    drive = straight_drive(tuple(range(frames)))
    folder.write_trajectory(drive, drive)
    folder.write_frames([frame_row(number) | {"state": "ok", "heldout": False} for number in range(frames)])
    folder.set_status("done", frames_done=frames, frames_total=frames)
    return path


def test_pictures_of_a_few_frames_are_in_memory_at_a_time(tmp_path: Path, tiny_config: dict[str, Any]) -> None:
    """Of 300; two threads have four frames under way or waiting for their turn."""
    frames = 300
    run = write_long_run(tmp_path / "run", tiny_config | {"threads": 2}, frames)
    metrics = evaluate_run(run)
    assert metrics["views"]["left"] == {
        **{"n": frames, "lpips": None, "depth_l1_cm": 200.0},
        **{"psnr_db": pytest.approx(20 * math.log10(255 / 4)), "ssim": pytest.approx(0.998, abs=0.002)},
    }
    assert LongDataset.most_alive <= 4


def test_the_poses_of_14000_frames_are_scored_in_linear_time() -> None:
    """A drive of 11 km on a winding road; what is quadratic takes a minute and 1.6 GB here."""
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (14000, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(
        np.cumsum(rng.normal(0, 0.02, (14000, 1)), axis=0) * [0.0, 1.0, 0.0]
    ).as_matrix()
    T[:, :3, 3] = np.cumsum(0.8 * T[:, :3, 2], axis=0)
    truth = Trajectory(T, np.arange(14000), 0.1 * np.arange(14000))
    estimate = Trajectory(T.copy(), truth.numbers, truth.timestamps)
    estimate.T_world_cam[:, :3, 3] += rng.normal(0, 0.01, (14000, 3))
    began = time.process_time()
    tracemalloc.start()
    pair = TrajectoryPair(estimate, truth, 0, 0, "number")
    metrics = score_pair(pair, "se3").metrics
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0.01 * math.sqrt(3), rel=0.02)
    assert metrics["trajectory"]["rpe_trans_rmse_m"] == pytest.approx(0.01 * math.sqrt(6), rel=0.02)
    assert peak < 100e6
    assert time.process_time() - began < 5
