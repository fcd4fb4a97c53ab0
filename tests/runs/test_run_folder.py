"""Making, reopening and filling a run folder."""

from __future__ import annotations

import dataclasses
import json
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.runs.folder import RunFolder, color_to_8bit, depth_to_16bit
from bench.runs.status import RunStatus, current_status, read_status, write_status
from bench.types import RenderedView, Trajectory

CONFIG: dict[str, Any] = {
    "dataset": {"name": "kitti", "sequence": "06", "frames": "0:10"},
    "stereo": {"name": "sgbm", "blocks": 5, "ratio": 1e-3},
    "seed": 0,
    "tags": [],
    "nothing": None,
}


def test_the_config_comes_back(tmp_path: Path) -> None:
    RunFolder.create(tmp_path / "deep" / "run", CONFIG, "abc123", rerun=False)
    run = SavedRunFolder(tmp_path / "deep" / "run")
    assert run.config == CONFIG
    assert run.config_hash == "abc123"


def test_another_config_is_refused_and_the_keys_named(tmp_path: Path) -> None:
    RunFolder.create(tmp_path / "run", CONFIG, "abc", rerun=False)
    other = CONFIG | {"stereo": {"name": "sgbm", "blocks": 7, "ratio": 1e-3}, "seed": 1, "rerun": True}
    with pytest.raises(BenchError, match=r"holds a run of another config \(it differs in seed, stereo\.blocks\)"):
        RunFolder.create(tmp_path / "run", other, "def", rerun=True)


def test_a_finished_run_is_left_alone_unless_rerun(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", CONFIG, "abc", rerun=False)
    folder.set_status("done", frames_done=10, frames_total=10)
    folder.write_json("metrics.json", {"a": 1})
    (folder.path / "my_notes.txt").write_text("keep me")
    again = RunFolder.create(tmp_path / "run", CONFIG, "abc", rerun=False)
    assert again.already_done
    assert (again.path / "metrics.json").is_file()
    fresh = RunFolder.create(tmp_path / "run", CONFIG, "abc", rerun=True)
    assert not fresh.already_done
    assert sorted(file.name for file in fresh.path.iterdir()) == ["config.yaml", "my_notes.txt"]


def test_an_unfinished_run_starts_anew(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", CONFIG, "abc", rerun=False)
    folder.set_status("interrupted", "Ctrl-C", 3, 10)
    picture = np.zeros((4, 4, 3), np.float32)
    folder.write_view("left", 12, RenderedView(picture, picture[..., 0], picture[..., 0]), picture[..., 0])
    folder.write_mask("moving", 12, np.eye(4, dtype=bool))
    assert (folder.path / "views/left/color/000012.png").is_file()
    written = cv2.imread(str(folder.path / "views/left/moving/000012.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(written, 255 * np.eye(4))
    again = RunFolder.create(tmp_path / "run", CONFIG, "abc", rerun=False)
    assert not again.already_done
    assert not any(file.is_file() for file in (again.path / "views").rglob("*"))


def test_places_that_can_not_hold_a_run(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="is a file"):
        RunFolder.create(tmp_path / "file", CONFIG, "abc", rerun=False)
    with pytest.raises(BenchError, match=r"Can't make the run folder .*file/run: Not a directory"):
        RunFolder.create(tmp_path / "file" / "run", CONFIG, "abc", rerun=False)
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "me.jpg").write_text("")
    with pytest.raises(BenchError, match=r"photos is not empty and holds no run \(config\.yaml is not there"):
        RunFolder.create(photos, CONFIG, "abc", rerun=True)
    assert [file.name for file in photos.iterdir()] == ["me.jpg"]


def test_hidden_files_do_not_make_a_folder_full(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
    RunFolder.create(tmp_path, CONFIG, "abc", rerun=False)


def test_a_folder_that_another_process_writes_is_refused(tmp_path: Path) -> None:
    RunFolder.create(tmp_path, CONFIG, "abc", rerun=False)
    other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        mine = current_status("running", "", 0, 10, (), "")
        write_status(tmp_path, dataclasses.replace(mine, pid=other.pid, process_started=None))
        with pytest.raises(BenchError, match=f"is being written by process {other.pid}"):
            RunFolder.create(tmp_path, CONFIG, "abc", rerun=True)
        # The same number, given to a process that started at another time, is not that run.
        write_status(tmp_path, dataclasses.replace(mine, pid=other.pid, process_started=1))
        status = read_status(tmp_path)
        assert status is not None
        assert status.describe() == "killed"
        RunFolder.create(tmp_path, CONFIG, "abc", rerun=False)
    finally:
        other.communicate(b"\n")


def test_status_tells_the_state_and_keeps_its_start(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path, CONFIG, "abc", rerun=False)
    folder.set_status("running", frames_total=10)
    started = json.loads((tmp_path / "status.json").read_text())["started"]
    folder.set_status("out_of_memory", "12 GB asked for", 4, 10)
    content = json.loads((tmp_path / "status.json").read_text())
    assert content["started"] == started
    assert (content["state"], content["reason"], content["frames_done"]) == ("out_of_memory", "12 GB asked for", 4)
    assert RunStatus(state="out_of_memory").describe() == "out of memory"
    with pytest.raises(BenchError, match="state='finished' is not one of running, done"):
        folder.set_status("finished")


def test_colours_are_clamped_and_rounded() -> None:
    color = np.array([[[-0.5, 0.0, 0.4 / 255], [0.6 / 255, 1.0, 7.0]]], np.float32)
    assert color_to_8bit(color).tolist() == [[[0, 0, 0], [1, 255, 255]]]
    everything = np.arange(256, dtype=np.float32).reshape(16, 16, 1).repeat(3, axis=2) / np.float32(255)
    assert np.array_equal(color_to_8bit(everything)[..., 0].ravel(), np.arange(256))


def test_depth_is_stored_as_256ths_of_a_metre() -> None:
    depth = np.array([[1.0, 2.001953125, np.nan, -3.0, 0.0, 300.0, np.inf]], np.float32)
    assert depth_to_16bit(depth).tolist() == [[256, 512, 0, 0, 0, 65535, 65535]]


def test_pictures_lie_where_they_should(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path, CONFIG, "abc", rerun=False)
    color = np.zeros((6, 8, 3), np.float32)
    color[..., 0] = 1.0
    depth = np.full((6, 8), 12.5, np.float32)
    folder.write_view("right", 1234567, RenderedView(color, depth, depth), depth)
    stored = cv2.imread(str(tmp_path / "views/right/color/1234567.png"))
    assert stored[0, 0].tolist() == [0, 0, 255], "OpenCV reads BGR; the red render must come back red"
    stored = cv2.imread(str(tmp_path / "views/right/depth/1234567.png"), cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint16
    assert (stored == 3200).all()


def test_trajectories_open_in_evo(tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    angles = np.linspace(0, 3.1, 9)
    T = np.tile(np.eye(4), (9, 1, 1))
    T[:, 0, 0] = T[:, 2, 2] = np.cos(angles)
    T[:, 0, 2], T[:, 2, 0] = np.sin(angles), -np.sin(angles)
    T[:, :3, 3] = np.random.default_rng(0).normal(size=(9, 3))
    one = Trajectory(T, np.arange(9), 0.1 * np.arange(9))
    RunFolder.create(tmp_path, CONFIG, "abc", rerun=False).write_trajectory(one, one)
    kitti = file_interface.read_kitti_poses_file(tmp_path / "trajectory_kitti.txt")
    tum = file_interface.read_tum_trajectory_file(tmp_path / "trajectory_tum.txt")
    truth = file_interface.read_kitti_poses_file(tmp_path / "ground_truth_kitti.txt")
    for path in (kitti, tum, truth):
        assert np.allclose(path.poses_se3, T, atol=1e-6)
    assert np.allclose(tum.timestamps, one.timestamps)


def test_the_log_holds_what_was_logged_meanwhile(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path, CONFIG, "abc", rerun=False)
    logger = logging.getLogger("bench.slam.system")
    level = logging.getLogger("bench").level
    with folder.attach_log():
        logger.info("frame 3 tracked")
        logging.getLogger("skimage").warning("slow path")
    logger.error("after the run")
    text = (tmp_path / "log.txt").read_text()
    assert "INFO bench.slam.system: frame 3 tracked" in text
    assert "WARNING skimage: slow path" in text
    assert "after the run" not in text
    assert logging.getLogger("bench").level == level
