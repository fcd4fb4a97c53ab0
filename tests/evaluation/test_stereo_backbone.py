"""Scoring a backbone: what it is compared with, in which order it is called, what counts as its time."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.contracts.stereo import DepthSource
from bench.errors import BenchError
from bench.evaluation.stereo_backbone import LIDAR, TRUE_DISPARITY, require_truth, score_backbone
from bench.evaluation.stereo_process import _without_the_current_folder
from bench.types import DepthMap, Map, StereoCamera, StereoFrame

IMAGE = np.zeros((2, 8, 3), np.uint8)


class Pairs(Dataset):
    """Frames of 8x2 pixels; the truth of frame i is 10 px in its first 4 i + 1 pixels. Focal length 100 px, 1 m."""

    label = "pairs"
    camera = StereoCamera(8, 2, 100.0, 100.0, 3.5, 0.5, (1.0, 0.0, 0.0))

    def __init__(self, truth: str, is_sequence: bool) -> None:
        self.numbers = (4, 5, 6)
        self.is_sequence = is_sequence
        self._truth = truth

    def frame(self, position: int) -> StereoFrame:
        return StereoFrame(self.numbers[position], 0.0, IMAGE, IMAGE)

    def true_disparity(self, position: int) -> Map | None:
        return self._map(position, 10.0) if self._truth == "disparity" else None

    def lidar_depth(self, position: int) -> Map | None:
        return self._map(position, 10.0) if self._truth == "lidar" and position != 1 else None

    def _map(self, position: int, value: float) -> Map:
        values = np.full(16, np.nan, np.float32)
        values[: 4 * position + 1] = value
        return values.reshape(2, 8)


class Recording(DepthSource):
    """Disparity 10 px in frames 4 and 5 and 16 px in frame 6; the very first call is slow."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def start(self, dataset: Dataset) -> None:
        self.calls.append("start")

    def depth(self, frame: StereoFrame, position: int, camera: StereoCamera) -> DepthMap:
        if not any(call.isdecimal() for call in self.calls):
            time.sleep(0.5)
        self.calls.append(str(frame.number))
        disparity = 16.0 if frame.number == 6 else 10.0
        return DepthMap(np.full((2, 8), 100.0 / disparity, np.float32), "recording")


def test_pooled_and_per_image() -> None:
    """1, 5 and 9 pixels with truth; the 9 of the last image are 6 px off: 60 % of the pixels, a third of the images."""
    source = Recording()
    done: list[tuple[int, int]] = []
    score = score_backbone(Pairs("disparity", True), source, 1, lambda n, total: done.append((n, total)))
    assert source.calls == ["start", "4", "start", "4", "5", "6"]
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert (score.dataset, score.truth) == ("pairs", TRUE_DISPARITY)
    assert [image.number for image in score.images] == [4, 5, 6]
    assert score.pooled.filled.d1_percent == pytest.approx(60.0)
    assert score.pooled.filled.epe_px == pytest.approx(0.6 * 6, rel=1e-5)
    assert score.image_mean(lambda one: one.interpolated.d1_percent) == pytest.approx(100 / 3)
    assert score.median_ms < 400, "the slow first call is the warm-up"
    assert score.peak_memory_gb > 0.01


def test_without_warm_up_the_first_call_is_timed() -> None:
    source = Recording()
    score = score_backbone(Pairs("disparity", True), source, 0)
    assert source.calls == ["start", "4", "5", "6"]
    assert score.images[0].ms > 450
    assert score.median_ms < 400


def test_single_pairs_are_each_begun_anew() -> None:
    source = Recording()
    score_backbone(Pairs("disparity", False), source, 1)
    assert source.calls == ["start", "4", "start", "4", "start", "5", "start", "6"]


def test_against_lidar_frames_without_a_scan_are_left_out() -> None:
    """LiDAR says 10 m in the images' first 1 and 9 pixels, which is 100 / 10 = 10 px."""
    source = Recording()
    score = score_backbone(Pairs("lidar", True), source, 0)
    assert (score.truth, [image.number for image in score.images]) == (LIDAR, [4, 6])
    assert source.calls == ["start", "4", "6"]
    assert score.pooled.filled.d1_percent == pytest.approx(90.0)


def test_nothing_to_score_against() -> None:
    for check in (require_truth, lambda dataset: score_backbone(dataset, Recording())):
        with pytest.raises(BenchError, match="pairs has neither disparities nor LiDAR to score stereo against"):
            check(Pairs("none", True))


def test_its_process_takes_no_module_from_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "json.py").write_text("open('proof', 'w').close()\n")
    monkeypatch.chdir(tmp_path)
    before = dict(os.environ)
    with _without_the_current_folder():
        subprocess.run([sys.executable, "-S", "-c", "import json"], check=True)
    assert dict(os.environ) == before
    assert not (tmp_path / "proof").exists()
