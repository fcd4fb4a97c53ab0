"""``bgs-bench score FOLDER`` on a data set of eight tiny frames: scores worked out by hand, and subsets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

import bench
from bench.cli import main
from bench.errors import BenchError
from bench.io.trajectories import write_tum
from bench.types import Trajectory
from tests.external.foreign_case import (
    COUNT,
    HEIGHT,
    WIDTH,
    arguments,
    curve,
    refusal,
    score,
    write_depth,
    write_poses,
    write_renders,
)

NUMBERS = np.arange(COUNT)
pytestmark = pytest.mark.usefixtures("no_plot")


def test_scores_worked_out_by_hand(folder: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metrics = score(folder, output)
    left = metrics["views"]["left"]
    assert (left["n"], left["psnr_db"]) == (COUNT, pytest.approx(20 * np.log10(255 / 4), abs=1e-9))
    assert left["depth_l1_cm"] == 50.0
    # The zigzag of 0.1 m is straight up and down, and hardly correlated with the way: alignment can't take it away.
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0.1, rel=0.03)
    assert metrics["frames"] == {
        **{
            "total": COUNT,
            "tracked": COUNT,
            "ok": COUNT,
            "weak": 0,
            "predicted": 0,
            "lost": 0,
            "lost_stretches": [],
            "mapped": 0,
        }
    }
    printed = capsys.readouterr().out
    for line in (
        "trajectory: est.txt, KITTI, 8 poses by position\n",
        "renders: eval/rendered_rgb, 8 of 8 frames by frame number\n",
        "right renders: none found\n",
        "depth: depth, 8 of 8 frames by frame number\n",
    ):
        assert line in printed
    config = yaml.safe_load((output / "config.yaml").read_text())
    assert not {"stereo", "tracker", "mapper", "system", "keyframer", "loss", "rasterizer", "sky"} & set(config)
    assert config["foreign"]["name"] == "Theirs"
    assert config["foreign"]["files"] == {"trajectory": "est.txt", "renders": "eval/rendered_rgb", "depth": "depth"}
    assert str(folder) not in (output / "config.yaml").read_text()


def test_the_run_is_one_like_any_other(folder: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = score(folder, output)
    before = {path: path.read_bytes() for path in output.rglob("*") if path.is_file()}
    for command in (["evaluate", str(output)], ["table", str(output)], arguments(folder, output)):
        assert main(command) == 0
        assert "Theirs" in capsys.readouterr().out
    after = {path: path.read_bytes() for path in output.rglob("*") if path.is_file()}
    assert {path.name for path in before if before[path] != after[path]} <= {"trajectory.png"}
    assert json.loads((output / "metrics.json").read_text()) == first


def test_from_python_it_is_the_same(folder: Path, output: Path) -> None:
    def scores(run: Path) -> dict[str, Any]:
        return dict(json.loads((run / "metrics.json").read_text()))

    by_command = score(folder, output)
    settings = {"dataset": "foreign_for_tests", "protocol": {"lpips": False, "depth_min_m": 0}}
    run = bench.score(folder, settings, output=output.with_name("from Python"), name="Theirs")
    assert run == output.with_name("from Python")
    assert scores(run) == by_command
    (run / "metrics.json").unlink()
    assert bench.score(run) == run
    assert scores(run) == by_command
    other = bench.score(run, ["protocol.alignment=none"], output=output.with_name("other"))
    assert (scores(other)["protocol"]["alignment"], scores(run)["protocol"]["alignment"]) == ("none", "se3")
    there = sorted(output.parent.rglob("*"))
    for place, wrong, text in (
        (run, {"name": "Theirs"}, "name is for another system's output"),
        (folder / "nowhere", {}, "There is no folder"),
        (folder, {"nam": "Theirs"}, "no setting 'nam'.*Did you mean"),
        (folder, {"name": "Theirs", "depth_scale": "256"}, "depth_scale must be a number"),
    ):
        with pytest.raises(BenchError, match=text):
            bench.score(place, settings, output=output.with_name("never"), **wrong)
    assert sorted(output.parent.rglob("*")) == there


def test_a_trajectory_alone(folder: Path, output: Path) -> None:
    metrics = score(folder, output, "--renders", "none", "--depth", "none")
    assert metrics["views"] == {}
    assert metrics["trajectory"]["rpe_trans_rmse_m"] == pytest.approx(0.2, rel=0.05)
    assert not (output / "views").exists()


def test_renders_alone_some_of_them(tmp_path: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_renders(tmp_path / "theirs" / "renders", [0, 2, 3], offset=8)
    metrics = score(tmp_path / "theirs", output)
    left = metrics["views"]["left"]
    assert (left["n"], left["psnr_db"]) == (3, pytest.approx(20 * np.log10(255 / 8), abs=1e-9))
    assert metrics["trajectory"]["ate_rmse_m"] is None
    assert metrics["notes"]["ate"] == "the system's output has no trajectory"
    assert metrics["notes"]["output"] == "renders of 3 of 8 frames; no depth"
    assert metrics["frames"]["tracked"] is None
    assert "│ 3/8 " in capsys.readouterr().out


def test_depth_alone_in_metres_with_a_hole(tmp_path: Path, output: Path) -> None:
    """In one of two frames half of the LiDAR's 12 m were not rendered: (0.5 + 12) / 2 m there, 0.5 m in the other."""
    (tmp_path / "theirs" / "depth").mkdir(parents=True)
    depth = np.full((HEIGHT, WIDTH), 12.5, np.float32)
    np.save(tmp_path / "theirs" / "depth" / "3.npy", depth)
    depth[:, : WIDTH // 2] = np.nan
    np.save(tmp_path / "theirs" / "depth" / "5.npy", depth)
    left = score(tmp_path / "theirs", output)["views"]["left"]
    assert left["depth_l1_cm"] == pytest.approx((625 + 50) / 2)
    assert "psnr_db" not in left


def test_lost_frames_are_counted_and_those_that_were_rendered_still_scored(
    folder: Path, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = np.array([0, 1, 2, 5, 6, 7])
    (folder / "est.txt").unlink()
    write_tum(folder / "est.txt", Trajectory(curve(kept), kept, 0.1 * kept + 0.002))
    metrics = score(folder, output)
    assert metrics["frames"]["lost_stretches"] == [[3, 4]]
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0, abs=1e-9)
    assert metrics["views"]["left"]["n"] == COUNT
    printed = capsys.readouterr().out
    assert "trajectory: est.txt, TUM, poses of 6 of 8 frames by time, within 0.01 s\n" in printed
    assert "done, 2 frames lost" in printed


def test_an_arbitrary_first_pose_does_not_matter(folder: Path, output: Path) -> None:
    """Any rigid motion of the world, here a quarter turn about x and 7 m sideways, leaves the errors as they are."""
    moved = np.array([[1.0, 0, 0, 7], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    before = score(folder, output)["trajectory"]
    T = np.loadtxt(folder / "est.txt").reshape(-1, 3, 4)
    write_poses(folder / "est.txt", moved @ np.concatenate([T, np.tile([[[0, 0, 0, 1.0]]], (COUNT, 1, 1))], axis=1))
    after = score(folder, output.with_name("moved"))["trajectory"]
    assert after["ate_rmse_m"] == pytest.approx(before["ate_rmse_m"], abs=1e-9)
    assert after["rpe_trans_rmse_m"] == pytest.approx(before["rpe_trans_rmse_m"], abs=1e-9)


def test_another_convention_is_hinted_at_and_can_be_said(
    folder: Path, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "est.txt").unlink()
    np.save(folder / "w2c.npy", np.linalg.inv(curve(NUMBERS)))
    score(folder, output)
    assert "--convention world_to_camera --axes opencv" in capsys.readouterr().out
    metrics = score(folder, output.with_name("said"), "--convention", "world_to_camera")
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0, abs=1e-9)
    assert "hint" not in capsys.readouterr().out


def test_a_convention_that_no_option_names_is_hinted_at_too(
    folder: Path, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Quaternions with w first: on the curve they turn about y, so that (0, y, 0, w) becomes (w, 0, y, 0)."""
    (folder / "est.txt").unlink()
    half = 0.01 * NUMBERS
    columns = [0.1 * NUMBERS, *curve(NUMBERS)[:, :3, 3].T, np.cos(half), 0 * half, np.sin(half), 0 * half]
    np.savetxt(folder / "est.txt", np.column_stack(columns))
    metrics = score(folder, output)
    assert "hint: estimate and ground truth seem to be written in different conventions" in capsys.readouterr().out
    assert "quaternions in the order w x y z" in metrics["notes"]["convention"]


def test_frame_numbers_and_positions(tmp_path: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Frames 10, 12 ... 24 of a sequence; renders by position, the trajectory one line per frame of the whole of it."""
    settings = ("dataset.first=10", "dataset.step=2")
    folder = tmp_path / "theirs"
    write_renders(folder / "renders", range(10, 26, 2))
    for position, file in enumerate(sorted((folder / "renders").iterdir())):
        file.rename(file.with_name(f"v{position}.png"))
    write_poses(folder / "est.txt", curve(np.arange(40)))
    metrics = score(folder, output, *settings)
    assert metrics["views"]["left"]["psnr_db"] == pytest.approx(20 * np.log10(255 / 4), abs=1e-9)
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0, abs=1e-9)
    printed = capsys.readouterr().out
    assert "trajectory: est.txt, KITTI, 8 poses by frame number, 32 of other frames left out" in printed
    assert "renders: renders, 8 of 8 frames by position" in printed


@pytest.mark.slow
def test_held_out_frames_are_scored_apart_only_if_the_system_never_saw_them(folder: Path, output: Path) -> None:
    """Remainder 2 of 5: frames 2 and 7."""
    protocol = "protocol=heldout"
    assert "heldout" not in score(folder, output, protocol)["views"]
    assert score(folder, output.with_name("said"), protocol, "--held-out")["views"]["heldout"]["n"] == 2


def test_score_yaml_and_what_is_known_of_resources(folder: Path, output: Path) -> None:
    (folder / "notes.txt").write_text("1 2 3\n")
    renders = write_renders(folder / "img", range(COUNT), offset=2, name="left_{}.png")
    write_renders(renders, range(COUNT), offset=9, name="right_{}.png")
    settings = {"name": "Hidden", "renders": "img/left_*.png", "resources": {"peak_memory_gb": 11.5, "gaussians": 7}}
    (folder / "score.yaml").write_text(yaml.safe_dump(settings))
    metrics = score(folder, output, "--name", "Said", "seed=3")
    assert metrics["views"]["left"]["psnr_db"] == pytest.approx(20 * np.log10(255 / 2), abs=1e-9)
    assert (metrics["resources"]["peak_memory_gb"], metrics["map"]["gaussians"]) == (11.5, 7)
    config = yaml.safe_load((output / "config.yaml").read_text())
    assert (config["foreign"]["name"], config["seed"]) == ("Said", 3)


def test_a_system_that_ran_out_of_memory(tmp_path: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """After three frames, or before the first one: both are runs that say so."""
    write_renders(tmp_path / "theirs" / "renders", [0, 1, 2])
    score(tmp_path / "theirs", output, "--status", "out_of_memory", "--reason", "24 GB were not enough")
    assert len(pd.read_csv(output / "frames.csv")) == 3
    status = json.loads((output / "status.json").read_text())
    assert (status["state"], status["frames_done"], status["frames_total"]) == ("out_of_memory", 3, COUNT)
    assert "stopped: 24 GB were not enough" in capsys.readouterr().out
    write_poses(tmp_path / "theirs" / "est.txt", curve(np.arange(4)))
    posed = score(tmp_path / "theirs", output.with_name("posed"), "--status", "failed")
    assert (posed["frames"]["total"], posed["frames"]["tracked"]) == (COUNT, 4)
    assert posed["trajectory"]["ate_rmse_m"] == pytest.approx(0, abs=1e-9)
    (tmp_path / "nothing").mkdir()
    metrics = score(tmp_path / "nothing", output.with_name("nothing"), "--status", "out_of_memory")
    assert metrics["views"] == {}


def test_colour_maps_of_depth_are_not_taken_for_depth(
    folder: Path, output: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """As SplaTAM writes them in its folder rendered_depth."""
    (folder / "depth").rename(folder / "rendered_depth")
    for file in (folder / "rendered_depth").iterdir():
        assert cv2.imwrite(str(file), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    assert "depth_l1_cm" not in score(folder, output)["views"]["left"]
    assert "is an 8-bit RGB picture, for looking at" in capfd.readouterr().out
    error = refusal(capfd, folder, output.with_name("asked"), "--depth", "rendered_depth")
    assert "is an 8-bit RGB picture" in error


def test_depth_in_another_unit(tmp_path: Path, output: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Millimetres read as KITTI's 1/256 m are 3.9 times as far; a user who gives a scale means it."""
    write_depth(tmp_path / "theirs" / "depth", range(COUNT), 12.5, scale=1000)
    error = refusal(capfd, tmp_path / "theirs", output)
    assert "the depth is 4.07 times LiDAR's in the median; --depth-scale 1.04e+03" in error
    left = score(tmp_path / "theirs", output, "--depth-scale", "1000")["views"]["left"]
    assert left["depth_l1_cm"] == pytest.approx(50, abs=100 / 512)
    capfd.readouterr()
    score(tmp_path / "theirs", output.with_name("meant"), "--depth-scale", "256")
    assert "hint: the depth is 4.07 times LiDAR's" in capfd.readouterr().out


def test_a_data_set_without_ground_truth(folder: Path, output: Path) -> None:
    metrics = score(folder, output, "dataset.has_truth=false")
    assert metrics["notes"]["ate"] == "the data set gives no ground-truth poses"
    assert metrics["views"]["left"]["n"] == COUNT
