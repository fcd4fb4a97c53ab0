"""``bgs-bench stereo-eval`` from the outside: backbones that work beside ones that break, files, wrong input."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from bench.cli import main

STREET = ("dataset=street", "dataset.frames=2", "dataset.width=160", "dataset.height=64")

PLUGINS = '''
"""Backbones for tests: the true disparity, half a pixel off; and two that break."""
import os
import signal
from dataclasses import dataclass

import numpy as np

from bench.contracts.stereo import DepthSource, StereoBackbone
from bench.registry import PluginConfig, register
from bench.types import DepthMap


@dataclass(frozen=True)
class OffsetConfig(PluginConfig):
    px: float = 0.5


@register("stereo", "offset_for_tests", config=OffsetConfig)
class Offset(DepthSource):
    """The truth, and a bit more."""

    def __init__(self, config):
        self._config = config

    def start(self, dataset):
        self._dataset = dataset

    def depth(self, frame, position, camera):
        disparity = self._dataset.true_disparity(position) + np.float32(self._config.px)
        return DepthMap(camera.fx * camera.baseline / disparity, "offset")


@register("stereo", "raising_for_tests")
class Raising(StereoBackbone):
    """Breaks."""

    def __init__(self, config):
        pass

    def disparity(self, left, right):
        raise ValueError("no\\nidea")


@register("stereo", "killed_for_tests")
class Killed(Raising):
    """Takes its process with it, as the kernel does when memory runs out."""

    def disparity(self, left, right):
        os.kill(os.getpid(), signal.SIGKILL)
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("plugins")
    (place / "backbones.py").write_text(PLUGINS)
    return place


@pytest.mark.slow
def test_broken_backbones_have_a_row_and_the_others_go_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    chosen = "raising_for_tests,offset_for_tests,killed_for_tests"
    settings = ("stereo.offset_for_tests.px=0.5,2.5", "--out", "t.csv", "t.md", "--per-image", "images.csv")
    assert main(["stereo-eval", f"stereo={chosen}", *STREET, f"plugins=[{folder}]", *settings]) == 1
    assert capfd.readouterr().err == ""
    with open(tmp_path / "t.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["stereo"], row["dataset"], row["status"]) for row in rows] == [
        ("raising_for_tests", "street/0", "failed"),
        ("offset_for_tests", "street/0", "done"),
        ("offset_for_tests (px=2.5)", "street/0", "done"),
        ("killed_for_tests", "street/0", "failed"),
    ]
    for row, px in ((rows[1], 0.5), (rows[2], 2.5)):
        assert float(row["epe_px"]) == pytest.approx(px, abs=1e-4)
        assert float(row["density_percent"]) == 100.0
        assert [float(row[f"bad{limit}_percent"]) for limit in (1, 2, 3)] == [100.0 * (px > n) for n in (1, 2, 3)]
        assert float(row["peak_memory_gb"]) > 0.05
    notes = (tmp_path / "t.md").read_text().replace("\\_", "_")
    assert "- raising_for_tests: ValueError: no idea (" in notes
    assert "backbones.py, line 42)" in notes
    assert "- killed_for_tests: its process was killed by signal 9, perhaps out of memory" in notes
    with open(tmp_path / "images.csv", newline="") as file:
        images = list(csv.DictReader(file))
    assert [(row["stereo"], row["number"]) for row in images[:2]] == [
        ("offset_for_tests", "0"),
        ("offset_for_tests", "1"),
    ]
    assert len(images) == 4


@pytest.mark.slow
def test_wrong_input_is_known_before_anything_is_scored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    cases = {
        ("stereo=sgmb",): "Unknown stereo 'sgmb'. Known: ",
        ("stereo=sgbm", "stereo=lidar"): "stereo=lidar: stereo= is given twice. Write the names with commas",
        ("stereo=sgbm", "tracker=groundtruth"): "tracker=groundtruth: stereo is scored without the rest of a system",
        ("stereo=sgbm", "stereo.num_disparites=96"): "Did you mean 'num_disparities'?",
        ("stereo=sgbm,lidar", "stereo.lidar.blocks=3"): "stereo.blocks=3: stereo has no setting 'blocks'",
        ("stereo=sgbm", "dataset=kitti2015"): "kitti2015: this folder does not exist",
        ("stereo=sgbm", "--out", "table.pdf"): "--out table.pdf: the extension says the form",
        ("stereo=sgbm", "--per-image", "images.txt"): "--per-image images.txt: it is written as CSV",
        ("stereo=sgbm", "--warm-up", "-1"): "--warm-up -1 is negative",
        ("stereo=sgbm", "--runs", "nowhere"): "There is no folder nowhere",
    }
    for arguments, message in cases.items():
        assert main(["stereo-eval", *arguments]) == 2
        assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_data_set_without_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tests.datasets.kitti_disk import write_kitti

    folder = write_kitti(tmp_path, frames=2)
    for scan in (folder / "velodyne").iterdir():
        scan.unlink()
    assert main(["stereo-eval", "dataset=kitti", f"dataset.root={tmp_path}", "dataset.sequence=04"]) == 2
    assert "kitti/04 has neither disparities nor LiDAR to score stereo against" in capsys.readouterr().err
