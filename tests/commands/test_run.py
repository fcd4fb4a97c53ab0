"""``bgs-bench run`` from the outside: the run folder, running again, sweeps, and runs that end early."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from conftest import SMALL, TINY, command, environment
from plyfile import PlyData

from bench.cli import main

Finished = tuple[Path, subprocess.CompletedProcess[str]]


def read(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text())
    assert isinstance(content, dict)
    return content


def times_of_files(folder: Path) -> dict[Path, int]:
    """When each was written last, but for the lock, into which whoever opens the folder writes its number."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.name != ".lock"}


def without_measurements(metrics: dict[str, Any]) -> dict[str, Any]:
    """Metrics but for what the machine's load decides: times and memory."""
    return metrics | {"resources": sorted(metrics["resources"])}


def test_run_folder_is_complete(finished_run: Finished) -> None:
    folder, process = finished_run
    assert (process.returncode, process.stderr) == (0, "")
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    pictures = {
        f"views/{view}/{what}/{number:06d}.png"
        for view in ("left", "right")
        for what in ("color", "depth")
        for number in range(4)
    }
    assert files == pictures | {
        *("config.yaml", "status.json", "provenance.json", "metrics.json", "per_frame.csv", "frames.csv"),
        "events.jsonl",
        *("trajectory.csv", "trajectory_kitti.txt", "trajectory_tum.txt", "ground_truth.csv"),
        *(
            "ground_truth_kitti.txt",
            "resources.json",
            "map.ply",
            "map_keyframes.npy",
            "log.txt",
            "trajectory.png",
            ".lock",
        ),
    }


def test_what_the_files_say(finished_run: Finished) -> None:
    folder, process = finished_run
    status = read(folder / "status.json")
    assert (status["state"], status["frames_done"], status["frames_total"]) == ("done", 4, 4)
    provenance = read(folder / "provenance.json")
    assert provenance["seed"] == 0
    frames = pd.read_csv(folder / "frames.csv")
    assert frames["number"].tolist() == [0, 1, 2, 3]
    assert frames["is_keyframe"].any()
    assert (frames["mapping_s"] >= 0).all()
    color = cv2.imread(str(folder / "views/left/color/000002.png"), cv2.IMREAD_UNCHANGED)
    depth = cv2.imread(str(folder / "views/left/depth/000002.png"), cv2.IMREAD_UNCHANGED)
    assert (color.shape, color.dtype) == ((64, 160, 3), np.uint8)
    assert (depth.shape, depth.dtype) == ((64, 160), np.uint16)
    assert PlyData.read(str(folder / "map.ply"))["vertex"].count == read(folder / "metrics.json")["map"]["gaussians"]
    assert len((folder / "trajectory_kitti.txt").read_text().splitlines()) == 4
    assert "keyframe" in (folder / "log.txt").read_text()
    for word in ("4 frames need about", "PSNR", "ATE", "Gaussians", "run folder:"):
        assert word in process.stdout


def test_form_of_the_metrics(finished_run: Finished) -> None:
    metrics = read(finished_run[0] / "metrics.json")
    assert {"protocol", "trajectory", "views", "resources", "map", "frames"} <= set(metrics)
    assert set(metrics["views"]) == {"left", "train", "right"}  # nothing was held out
    for group in ("left", "train"):
        assert set(metrics["views"][group]) == {"n", "psnr_db", "ssim", "lpips", "depth_l1_cm"}
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)  # tracker=groundtruth
    stages = [f"{stage}_s_per_frame" for stage in ("tracking", "stereo", "mapping")]
    assert {"peak_memory_gb", *stages} <= set(metrics["resources"])
    assert metrics["trajectory"]["rpe_pairs"] == 3
    assert metrics["trajectory"]["static_camera_ate_rmse_m"] > 0.1
    assert metrics["frames"] == {
        **{"total": 4, "tracked": 4, "ok": 4, "weak": 0, "predicted": 0, "lost": 0, "lost_stretches": []},
        "mapped": metrics["views"]["train"]["n"],
    }


def test_psnr_of_the_table_is_that_of_the_saved_pictures(finished_run: Finished) -> None:
    """Worked out here from the PNGs and the street's images."""
    from plugins.datasets.street import Street, StreetConfig

    dataset = Street(StreetConfig("street", frames=4, width=160, height=64))
    values = []
    for number in range(4):
        path = finished_run[0] / f"views/left/color/{number:06d}.png"
        shown = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB).astype(float)
        values.append(10 * np.log10(255**2 / ((shown - dataset.frame(number).left) ** 2).mean()))
    assert read(finished_run[0] / "metrics.json")["views"]["left"]["psnr_db"] == pytest.approx(np.mean(values))


@pytest.fixture
def copy(finished_run: Finished, tmp_path: Path) -> Path:
    """A copy of the finished run that a test may change. (Where a run lies is no part of what it is.)"""
    return Path(shutil.copytree(finished_run[0], tmp_path / "run"))


def test_a_finished_run_is_not_run_again(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = times_of_files(copy)
    assert main(["run", *TINY, f"output={copy}"]) == 0
    assert "already done; rerun=true runs it again" in capsys.readouterr().out
    assert times_of_files(copy) == before


@pytest.mark.slow
def test_rerun_gives_the_same_numbers_and_the_same_bytes(copy: Path, finished_run: Finished) -> None:
    """Also a proof that a fresh process and this one agree."""
    assert main(["run", *TINY, f"output={copy}", "rerun=true"]) == 0
    assert read(copy / "status.json")["started"] > read(finished_run[0] / "status.json")["started"]
    assert without_measurements(read(copy / "metrics.json")) == without_measurements(
        read(finished_run[0] / "metrics.json")
    )
    for name in (
        "map.ply",
        "trajectory.csv",
        "per_frame.csv",
        "views/left/color/000003.png",
        "views/right/depth/000001.png",
    ):
        assert (copy / name).read_bytes() == (finished_run[0] / name).read_bytes(), name


@pytest.mark.slow
def test_another_seed_gives_another_map(finished_run: Finished, tmp_path: Path) -> None:
    assert main(["run", *TINY, "seed=1", f"output={tmp_path / 'run'}"]) == 0
    assert (tmp_path / "run/map.ply").read_bytes() != (finished_run[0] / "map.ply").read_bytes()


def test_evaluate_gives_the_same_metrics(copy: Path) -> None:
    before = read(copy / "metrics.json")
    (copy / "metrics.json").unlink()
    (copy / "per_frame.csv").unlink()
    assert main(["evaluate", str(copy)]) == 0
    assert read(copy / "metrics.json") == before
    assert (copy / "per_frame.csv").is_file()


@pytest.mark.slow
def test_a_run_without_scores_is_scored_when_asked_for_again(copy: Path) -> None:
    before = read(copy / "metrics.json")
    (copy / "metrics.json").unlink()
    assert main(["run", *TINY, f"output={copy}"]) == 0
    assert read(copy / "metrics.json") == before


def test_the_folder_of_another_config_is_left_alone(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = times_of_files(copy)
    assert main(["run", *TINY, "seed=3", f"output={copy}", "rerun=true"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("bgs-bench: ")
    assert "holds a run of another config (it differs in seed)" in error
    assert error.count("\n") == 1
    assert times_of_files(copy) == before


@pytest.mark.slow
def test_a_sweep_makes_a_folder_a_cell_and_a_table_and_a_cell_that_fails_stops_no_other(
    tmp_path: Path, stopping_plugin: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Overrides may stand on both sides of -m. (A sweep without failures: tests/sweeps/test_launchers_real.py.)"""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    options = [f"plugins=[{stopping_plugin}]", "tracker=stopping_for_tests,groundtruth", "output=sweep"]
    assert main(["run", *SMALL, "-m", *options, "seed=3"]) == 1
    said = capfd.readouterr()
    assert "Traceback" not in said.out + said.err
    runs = sorted(path.parent for path in (tmp_path / "sweep").glob("*/status.json"))
    assert sorted(read(run / "status.json")["state"] for run in runs) == ["done", "failed"]
    assert [read(run / "provenance.json")["seed"] for run in runs] == [3, 3]
    for run in runs:
        assert said.out.count(run.name) >= 1
    assert [path.name for path in tmp_path.iterdir()] == ["sweep"]


@pytest.mark.slow
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_says_interrupted_and_keeps_what_was_done(
    tmp_path: Path, stopping_plugin: Path, signum: signal.Signals
) -> None:
    marker, folder = tmp_path / "marker", tmp_path / "run"
    options = [f"plugins=[{stopping_plugin}]", "tracker=stopping_for_tests", "tracker.how=wait"]
    arguments = ["run", *SMALL, *options, f"tracker.marker={marker}", f"output={folder}"]
    process = subprocess.Popen(
        command(arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=environment(),
    )
    # The tracker waits in frame 2, and the mapper is done with frame 1.
    deadline, log_file = time.monotonic() + 60, folder / "log.txt"
    while process.poll() is None and time.monotonic() < deadline:
        if marker.exists() and "frame 1: keyframe" in log_file.read_text():
            break
        time.sleep(0.05)
    assert marker.exists(), process.communicate()[1]
    time.sleep(0.2)
    assert read(folder / "status.json")["state"] == "running"
    process.send_signal(signum)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == "bgs-bench: interrupted; what was done is in the run folder\n"
    status = read(folder / "status.json")
    assert (status["state"], status["frames_done"], status["frames_total"]) == ("interrupted", 2, 4)
    assert len((folder / "trajectory_kitti.txt").read_text().splitlines()) == 2
    assert PlyData.read(str(folder / "map.ply"))["vertex"].count > 100
    assert len(pd.read_csv(folder / "frames.csv")) == 2
    assert main(["table", str(folder)]) == 0
    assert main(["evaluate", str(folder)]) == 0
    assert read(folder / "metrics.json")["frames"] == {
        **{"total": 4, "tracked": 2, "ok": 2, "weak": 0, "predicted": 0, "lost": 0, "lost_stretches": [], "mapped": 2}
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "state", "reason"),
    [
        ("raise", "failed", "ValueError: the tracker is\nbroken"),
        ("memory", "out_of_memory", "MemoryError"),
    ],
)
def test_a_run_that_breaks(
    tmp_path: Path, stopping_plugin: Path, how: str, state: str, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    options = [f"plugins=[{stopping_plugin}]", "tracker=stopping_for_tests", f"tracker.how={how}"]
    assert main(["run", *SMALL, *options, f"output={folder}"]) == 1
    said = capfd.readouterr()
    assert said.err.count("\n") == 1
    assert said.err.startswith(f"bgs-bench: The run failed: {' '.join(reason.split())}")
    assert "stopping.py" in said.err
    assert f"the traceback is in {folder / 'log.txt'}" in said.err
    assert "Traceback" not in said.out + said.err
    status = read(folder / "status.json")
    assert (status["state"], status["reason"], status["frames_done"]) == (state, reason, 2)
    assert "Traceback" in (folder / "log.txt").read_text()
    assert (folder / "map.ply").is_file()
    assert len((folder / "trajectory_kitti.txt").read_text().splitlines()) == 2


def test_print_config_runs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", *TINY, f"output={tmp_path / 'run'}", "--print-config"]) == 0
    shown = capsys.readouterr().out
    assert "iterations: 2" in shown
    assert "name: street" in shown
    assert not (tmp_path / "run").exists()
