"""Scoring a saved run whose numbers follow from how it was written."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run, merge
from bench.evaluation.saved_run import SavedRunFolder
from bench.runs.config_file import read_config
from bench.runs.folder import RunFolder, picture_path
from bench.runs.status import read_status
from bench.sweeps.lookup import Found, look_up
from bench.types import StereoFrame
from plugins.evaluators.resources import memory_growth
from tests.evaluation.tiny_run import (
    HELD_OUT,
    LEFT_ERROR,
    LOST,
    NUMBERS,
    RIGHT_ERROR,
    TinyConfig,
    TinyDataset,
    frame_row,
    write_tiny_run,
)

NONE_DONE = {"tracked": 0, "ok": 0, "weak": 0, "predicted": 0, "lost": 0, "lost_stretches": [], "mapped": 0}


def psnr_of(*errors: int) -> float:
    return float(np.mean([20 * math.log10(255 / error) for error in errors]))


ENDS: list[tuple[BaseException, str, str]] = [
    (KeyboardInterrupt(), "interrupted", "scoring was interrupted"),
    (ValueError("no such colour"), "failed", "scoring: ValueError: no such colour"),
    (SystemExit(0), "failed", "scoring: SystemExit: 0"),
    (MemoryError("too much"), "out_of_memory", "scoring: too much"),
]


@pytest.mark.parametrize(("end", "state", "reason"), ENDS, ids=lambda each: type(each).__name__)
def test_scoring_that_ends_early_is_told_and_the_run_is_kept(
    end: BaseException, state: str, reason: str, tiny_run: Path
) -> None:
    """The next time only the scores are made, which are those of an unbroken run."""

    def ending(what: str, done: int, total: int) -> None:
        raise end

    before = read_status(tiny_run)
    with pytest.raises(type(end)):
        evaluate_run(tiny_run, ending)
    status = read_status(tiny_run)
    assert status is not None
    assert (status.state, status.reason) == (state, reason)
    assert status.is_complete
    assert RunFolder.create(tiny_run, *read_config(tiny_run) or ({}, ""), rerun=False).already_done
    assert look_up(tiny_run) == Found("interrupted", reason)
    evaluate_run(tiny_run)
    assert read_status(tiny_run) == before
    assert look_up(tiny_run) == Found("finished")


def test_a_polite_kill_while_scoring_is_an_interruption(tiny_run: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        evaluate_run(tiny_run, lambda what, done, total: signal.raise_signal(signal.SIGTERM))
    status = read_status(tiny_run)
    assert status is not None
    assert (status.state, status.reason) == ("interrupted", "scoring was interrupted")


def test_what_is_doubtful_stays_with_the_scores(tiny_run: Path) -> None:
    """Warnings of a run are in its status from then on, and in the notes of its scores; a run without has no note."""
    assert "warning" not in evaluate_run(tiny_run).get("notes", {})
    folder = RunFolder(tiny_run, already_done=False)
    folder.warnings = ["the baseline is 537 metres", "no depth in frame 3"]
    folder.set_status("done", frames_done=5, frames_total=5)
    status = read_status(tiny_run)
    assert status is not None
    assert status.warnings == folder.warnings
    assert evaluate_run(tiny_run)["notes"]["warning"] == "the baseline is 537 metres; no depth in frame 3"


def test_scores_that_are_there_are_not_spoilt_by_scoring_again_in_vain(tiny_run: Path) -> None:
    metrics = evaluate_run(tiny_run)
    shutil.rmtree(tiny_run / "views" / "left")
    picture_path(tiny_run, "left", "color", 10).parent.mkdir(parents=True)
    picture_path(tiny_run, "left", "color", 10).write_bytes(b"damaged")
    with pytest.raises(BenchError):
        evaluate_run(tiny_run)
    status = read_status(tiny_run)
    assert status is not None
    assert status.state == "done"
    assert json.loads((tiny_run / "metrics.json").read_text())["views"] == metrics["views"]


def test_an_image_that_changed_since_the_run_read_it_is_told(tiny_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One pixel of one image, by one grey level."""
    dataset = TinyDataset(TinyConfig())
    rows = [frame_row(number) for number in NUMBERS]
    for position, row in enumerate(rows):
        row["images_crc32"] = dataset.frame(position).checksum()
    pd.DataFrame(rows).to_csv(tiny_run / "frames.csv", index=False)
    evaluate_run(tiny_run)
    unchanged = TinyDataset.frame

    def overwritten(self: TinyDataset, position: int) -> StereoFrame:
        frame = unchanged(self, position)
        assert frame.right is not None
        if frame.number == 13:
            frame.right[3, 5, 1] += 1
        return frame

    monkeypatch.setattr(TinyDataset, "frame", overwritten)
    with pytest.raises(BenchError, match=r"images of frame 13 of tiny have changed since the run read them"):
        evaluate_run(tiny_run)


def no_constants(value: str) -> None:
    raise AssertionError(f"{value} in JSON")


def test_metrics_are_those_that_the_run_was_made_with(tiny_run: Path) -> None:
    metrics = evaluate_run(tiny_run)
    views = metrics["views"]
    assert {group: views[group]["n"] for group in views} == {"left": 4, "train": 3, "heldout": 1, "right": 4}
    assert views["left"]["psnr_db"] == pytest.approx(psnr_of(*LEFT_ERROR.values()))
    assert views["train"]["psnr_db"] == pytest.approx(psnr_of(1, 2, 4))
    assert views["heldout"]["psnr_db"] == pytest.approx(psnr_of(LEFT_ERROR[HELD_OUT]))
    assert views["right"]["psnr_db"] == pytest.approx(psnr_of(RIGHT_ERROR))
    assert views["heldout"]["ssim"] < views["train"]["ssim"] < 1
    assert metrics["trajectory"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert metrics["frames"] == {
        **{
            "total": 5,
            "tracked": 4,
            "ok": 4,
            "weak": 0,
            "predicted": 0,
            "lost": 1,
            "lost_stretches": [[LOST, LOST]],
            "mapped": 3,
        }
    }
    assert metrics["map"] == {"gaussians": 1234}
    assert metrics["resources"]["peak_memory_gb"] == 0.5
    assert metrics["protocol"]["holdout_every"] == 5


def test_trajectory_metrics_know_the_lost_frame(tiny_run: Path) -> None:
    """One metre a frame on frames 10 to 14; 12 is lost: pairs 10-11 and 13-14 are left."""
    trajectory = evaluate_run(tiny_run)["trajectory"]
    assert trajectory["rpe_trans_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert (trajectory["rpe_pairs"], trajectory["rpe_pairs_lost"], trajectory["rpe_frame_distance"]) == (2, 2, 1)
    # Places 10 to 14 are 2 m^2 from their mean; 10, 11, 13, 14 are 2.5.
    assert trajectory["static_camera_ate_rmse_m"] == pytest.approx(math.sqrt(2.0))
    assert trajectory["static_camera_compared_ate_rmse_m"] == pytest.approx(math.sqrt(2.5))
    table = pd.read_csv(tiny_run / "per_frame.csv").set_index(["view", "number"])
    assert table.loc["left", "rpe_trans_m"].notna().to_dict() == {10: False, 11: True, 13: False, 14: True}


def test_a_path_without_segments_says_so(tiny_run: Path) -> None:
    metrics = evaluate_run(tiny_run)
    assert metrics["trajectory"]["t_rel_percent"] is None
    note = "the path of 4.0 m is not longer than the shortest segment, 10 m"
    assert metrics["notes"]["kitti_odometry"] == note


def test_the_distance_of_a_pair_can_be_chosen(tmp_path: Path, tiny_config: dict[str, Any]) -> None:
    tiny_config["evaluator"]["rpe"]["frame_distance"] = 3
    trajectory = evaluate_run(write_tiny_run(tmp_path / "run", tiny_config))["trajectory"]
    assert (trajectory["rpe_pairs"], trajectory["rpe_pairs_lost"], trajectory["rpe_frame_distance"]) == (2, 0, 3)
    tiny_config["evaluator"]["rpe"]["frame_distance"] = 0
    with pytest.raises(BenchError, match=r"evaluator\.rpe\.frame_distance=0 must be 1 or more"):
        evaluate_run(write_tiny_run(tmp_path / "other", tiny_config))


def test_depth_is_scored_on_left_views_with_returns(tiny_run: Path) -> None:
    """LiDAR says 12 m, the render 10 m; nothing was rendered in the held-out frame; frame 14 has no scan."""
    metrics = evaluate_run(tiny_run)
    views = metrics["views"]
    assert views["train"]["depth_l1_cm"] == pytest.approx(200.0)
    assert views["heldout"]["depth_l1_cm"] == pytest.approx(1200.0)
    assert views["left"]["depth_l1_cm"] == pytest.approx((200 + 200 + 1200) / 3)
    assert "depth_l1_cm" not in views["right"]
    assert metrics["notes"]["depth_l1"] == "3 of 4 left views have LiDAR returns in range"


def test_where_mapping_saw_right_images_only_held_out_ones_are_scored(tiny_run: Path) -> None:
    before = evaluate_run(tiny_run)
    assert before["protocol"]["right_images_mapped"] is False
    assert before["views"]["right"]["n"] == 4
    assert "right" not in before.get("notes", {})
    frames = pd.read_csv(tiny_run / "frames.csv")
    frames["right_mapped"] = np.where(frames["number"] == 11, True, None)
    frames.to_csv(tiny_run / "frames.csv", index=False)
    metrics = evaluate_run(tiny_run)
    assert metrics["protocol"]["right_images_mapped"] is True
    assert metrics["views"]["right"]["n"] == 1
    assert metrics["notes"]["right"].endswith("at held-out frames only")
    per_frame = pd.read_csv(tiny_run / "per_frame.csv")
    assert per_frame[per_frame["view"] == "right"]["number"].tolist() == [HELD_OUT]
    frames["heldout"] = False
    frames.to_csv(tiny_run / "frames.csv", index=False)
    metrics = evaluate_run(tiny_run)
    assert "right" not in metrics["views"]
    assert metrics["notes"]["right"].endswith("not at all, since none is held out")


def test_files_hold_the_same_and_no_nan(tiny_run: Path) -> None:
    metrics = evaluate_run(tiny_run)
    written = json.loads((tiny_run / "metrics.json").read_text(), parse_constant=no_constants)
    assert written == json.loads(json.dumps(metrics))
    resources = json.loads((tiny_run / "resources.json").read_text(), parse_constant=no_constants)
    assert resources["mapping_s_per_frame"] is None
    table = pd.read_csv(tiny_run / "per_frame.csv").set_index(["view", "number"])
    assert len(table) == 8
    assert table.loc[("left", 11), "psnr_db"] == pytest.approx(psnr_of(2))
    assert table.loc[("left", 10), "depth_pixels"] == 20 * 56


def test_evaluating_again_gives_the_same_bytes(tiny_run: Path) -> None:
    evaluate_run(tiny_run)
    first = {name: (tiny_run / name).read_bytes() for name in ("metrics.json", "per_frame.csv")}
    evaluate_run(tiny_run)
    assert first == {name: (tiny_run / name).read_bytes() for name in first}


def test_each_picture_is_decoded_once_for_all(
    tmp_path: Path, tiny_config: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight renders, four left depths; the depth of right views nobody asks for."""
    tiny_config["evaluator"] |= {name: {"name": name} for name in ("regions", "dialects")}
    run = SavedRunFolder(write_tiny_run(tmp_path / "run", tiny_config))
    read: list[str] = []
    monkeypatch.setattr(
        run, "_picture", lambda path, *how: read.append(path) or SavedRunFolder._picture(run, path, *how)
    )
    decoded = run.dataset.decoded  # type: ignore[attr-defined]
    monkeypatch.setattr("bench.evaluation.run_evaluators.SavedRunFolder", lambda path: run)
    steps: list[tuple[str, int, int]] = []
    evaluate_run(run.path, lambda *step: steps.append(step))
    assert len(read) == len(set(read)) == 8 + 4
    assert sorted(decoded) == [number for number in NUMBERS if number != LOST]
    assert steps[-1][1] == steps[-1][2] == 4


def test_what_nobody_asks_for_is_not_decoded(tmp_path: Path, tiny_config: dict[str, Any]) -> None:
    tiny_config["evaluator"] = {"depth_l1": {"name": "depth_l1"}}
    run = SavedRunFolder(write_tiny_run(tmp_path / "run", tiny_config))
    for number in LEFT_ERROR:
        picture_path(run.path, "left", "color", number).write_text("no picture")
    assert "depth_l1_cm" in evaluate_run(run.path)["views"]["left"]


def test_lpips_is_reported_or_explained(
    tmp_path: Path, tiny_config: dict[str, Any], weights_root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny_config["protocol"]["lpips"] = True
    run = write_tiny_run(tmp_path / "run", tiny_config)
    monkeypatch.setattr("bench.evaluation.run_lpips.find_alexnet_weights", lambda _: "no weights: looked around")
    metrics = evaluate_run(run)
    assert metrics["views"]["left"]["lpips"] is None
    assert metrics["notes"]["lpips"] == "no weights: looked around"
    monkeypatch.undo()
    weights = weights_root / "lpips" / "alex_features.npz"
    tiny_config["protocol"]["lpips_weights"] = str(weights)
    other = write_tiny_run(tmp_path / "other", tiny_config)
    (other / "provenance.json").write_text('{"seed": 7, "weights": {}}')
    metrics = evaluate_run(other)
    assert (
        0
        < metrics["views"]["train"]["lpips"]
        < metrics["views"]["heldout"]["lpips"]
        < metrics["views"]["right"]["lpips"]
    )
    assert "lpips_weights" not in metrics["protocol"]
    sha256 = hashlib.sha256(weights.read_bytes()).hexdigest()
    assert metrics["protocol"]["lpips_weights_sha256"] == sha256
    provenance = json.loads((other / "provenance.json").read_text())
    assert provenance == {"seed": 7, "weights": {"lpips": {"file": "alex_features.npz", "sha256": sha256}}}


def test_an_interrupted_run_is_scored_as_far_as_it_got(tmp_path: Path, tiny_config: dict[str, Any]) -> None:
    run = write_tiny_run(tmp_path / "run", tiny_config, state="interrupted")
    for number in (13, 14):
        picture_path(run, "left", "color", number).unlink()
    for name in ("resources.json", "trajectory.csv"):
        (run / name).unlink()
    metrics = evaluate_run(run)
    assert metrics["views"]["left"]["n"] == 2
    assert "heldout" not in metrics["views"]
    assert metrics["resources"]["peak_memory_gb"] is None
    assert metrics["map"] == {"gaussians": None}
    for name in ("ate", "rpe", "kitti_odometry"):
        assert metrics["notes"][name] == "the run stopped before it saved its trajectory"
    assert metrics["trajectory"]["static_camera_ate_rmse_m"] == pytest.approx(math.sqrt(2.0))


def test_a_run_that_failed_at_once_has_metrics_without_views(tmp_path: Path, tiny_config: dict[str, Any]) -> None:
    folder = RunFolder.create(tmp_path / "run", tiny_config, "hash", rerun=False)
    folder.set_status("failed", "no image", 0, 7)
    folder.write_frames([])
    metrics = evaluate_run(folder.path)
    assert metrics["views"] == {}
    assert metrics["frames"] == {"total": 7, **NONE_DONE}


def test_a_finished_run_that_lacks_a_render_is_an_error(tiny_run: Path) -> None:
    picture_path(tiny_run, "right", "color", 11).unlink()
    with pytest.raises(BenchError, match=r"right/color/000011\.png is missing though the run is done"):
        evaluate_run(tiny_run)


def test_views_that_a_mapper_could_not_render_are_absent(tiny_run: Path) -> None:
    """Left views of 10 and 14 of the tracked 10, 11, 13, 14; they are no black images, and no loss of the run."""
    frames = pd.read_csv(tiny_run / "frames.csv")
    frames["left_color"] = frames["left_depth"] = frames["number"].isin([11, 13])
    frames["right_color"] = frames["state"] != "lost"
    frames["absent"] = frames["number"].isin([10, 14]).map({True: "the view has no depth", False: ""})
    frames.to_csv(tiny_run / "frames.csv", index=False)
    for number in (10, 14):
        picture_path(tiny_run, "left", "color", number).unlink()
        picture_path(tiny_run, "left", "depth", number).unlink()
    metrics = evaluate_run(tiny_run)
    assert {group: values["n"] for group, values in metrics["views"].items()} == {
        **{"left": 2, "train": 1, "heldout": 1, "right": 4}
    }
    assert metrics["views"]["left"]["psnr_db"] == pytest.approx(psnr_of(LEFT_ERROR[11], LEFT_ERROR[HELD_OUT]))
    assert "renders of 2 of 5 frames" in metrics["notes"]["output"]
    assert "the view has no depth" in metrics["notes"]["output"]
    assert metrics["frames"]["tracked"] == 4


def test_without_right_views_there_is_no_right_group(tmp_path: Path, tiny_config: dict[str, Any]) -> None:
    tiny_config["protocol"]["right_view"] = False
    assert "right" not in evaluate_run(write_tiny_run(tmp_path / "run", tiny_config))["views"]


def test_two_evaluators_may_not_disagree() -> None:
    metrics: dict[str, Any] = {"views": {"left": {"n": 3}}}
    merge(metrics, {"views": {"left": {"n": 3, "ssim": 0.5}, "right": {"n": 1}}})
    assert metrics == {"views": {"left": {"n": 3, "ssim": 0.5}, "right": {"n": 1}}}
    with pytest.raises(BenchError, match=r"Two evaluators give views\.left\.n as 3 and 4"):
        merge(metrics, {"views": {"left": {"n": 4}}})


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("frames.csv", None, r"frames\.csv is missing: the run did not get far enough"),
        ("frames.csv", "number,state\n1,ok\n", r"frames\.csv lacks the column 'timestamp'"),
        ("trajectory.csv", "number,timestamp\n1", r"trajectory\.csv lacks the column 'T_00'"),
        ("status.json", '{"state": "done"', r"status\.json is damaged \(line 1"),
        ("status.json", '{"state": "gone"}', r"status\.json names no known state"),
        ("status.json", None, r"is incomplete: it has no status\.json"),
        ("resources.json", "[1]", r"resources\.json should hold a JSON object"),
        ("config.yaml", "a: 1", r"is no run folder: it has no config\.yaml"),
        ("views/left/color/000011.png", "cut off", r"left/color/000011\.png is damaged"),
        ("views/left/depth/000010.png", "", r"left/depth/000010\.png is damaged"),
    ],
)
def test_damaged_folders_are_named(tiny_run: Path, file: str, content: str | None, message: str) -> None:
    if content is None:
        (tiny_run / file).unlink()
    else:
        (tiny_run / file).write_text(content)
    with pytest.raises(BenchError, match=message):
        evaluate_run(tiny_run)
    assert not (tiny_run / "metrics.json").exists()


def test_a_folder_that_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="There is no run folder"):
        SavedRunFolder(tmp_path / "nothing")
    with pytest.raises(BenchError, match=r"has no config\.yaml that `bgs-bench run` wrote"):
        SavedRunFolder(tmp_path)


def test_trajectories_come_back_bit_by_bit(tmp_path: Path, tiny_run: Path) -> None:
    from bench.runs.trajectory_csv import as_csv, read_trajectory_csv
    from bench.types import Trajectory

    T = np.tile(np.eye(4), (50, 1, 1))
    T[:, :3] = np.random.default_rng(0).normal(size=(50, 3, 4)) / 3
    one = Trajectory(T, np.arange(50), np.random.default_rng(1).uniform(size=50))
    (tmp_path / "t.csv").write_text(as_csv(one))
    two = read_trajectory_csv(tmp_path / "t.csv")
    assert np.array_equal(one.T_world_cam, two.T_world_cam)
    assert np.array_equal(one.timestamps, two.timestamps)
    assert list(SavedRunFolder(tiny_run).trajectory.numbers) == [10, 11, 13, 14]


def test_depth_comes_back_in_metres(tiny_run: Path) -> None:
    run = SavedRunFolder(tiny_run)
    depth = run.depth("left", 10)
    assert depth is not None
    assert np.all(depth == 10.0)
    hole = run.depth("left", HELD_OUT)
    assert hole is not None
    assert np.isnan(hole).all()
    assert run.depth("left", LOST) is None
    assert run.render("right", LOST) is None


def test_memory_that_grows_is_followed_to_48_gb() -> None:
    """1 GB that is loaded in the first half, then 10 MB a frame: 1.4 GB after 40 frames, 48 GB after 4700."""
    frames = pd.DataFrame({"memory_gb": [*np.linspace(0.2, 1.2, 20), *(1.21 + 0.01 * np.arange(20))]})
    found = memory_growth(frames)
    assert found == {"memory_growth_mb_per_frame": pytest.approx(10.0), "frames_to_48_gb": 4700}
    unknown = {"memory_growth_mb_per_frame": None, "frames_to_48_gb": None}
    assert memory_growth(frames[:9]) == memory_growth(pd.DataFrame({"memory_gb": ["x"] * 20})) == unknown
    assert memory_growth(pd.DataFrame({"number": range(20)})) == unknown
    shrinking = memory_growth(pd.DataFrame({"memory_gb": 2 - 0.01 * np.arange(20)}))
    assert shrinking == {"memory_growth_mb_per_frame": pytest.approx(-10.0), "frames_to_48_gb": None}
