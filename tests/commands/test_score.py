"""``bgs-bench score`` from the outside: real trajectories, its JSON, its picture, and its errors in one line."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.cli import main


def write_poses(path: Path, steps: int, scale: float = 1.0) -> Path:
    """A KITTI file: straight ahead, one metre a frame times ``scale``."""
    path.write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {scale * i!r}\n" for i in range(steps)))
    return path


def no_constants(value: str) -> None:
    raise AssertionError(f"{value} in JSON")


def scored(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    assert main(["score", *map(str, arguments), "--json"]) == 0
    out, error = capsys.readouterr()
    assert error == ""
    content = json.loads(out, parse_constant=no_constants)
    assert isinstance(content, dict)
    return content


def test_json_has_the_form_of_metrics_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The straight drive of 900 m whose t_rel can be worked out by hand; its RMS distance from the middle too."""
    truth, estimate = write_poses(tmp_path / "gt.txt", 901), write_poses(tmp_path / "estimate.txt", 901, 1.01)
    metrics = scored(capsys, "--trajectory", estimate, "--ground-truth", truth)
    assert {"protocol", "trajectory", "frames", "notes"} == set(metrics)
    trajectory = metrics["trajectory"]
    along = np.sqrt((901**2 - 1) / 12)
    assert trajectory["static_camera_ate_rmse_m"] == pytest.approx(along)
    assert trajectory["ate_rmse_m"] == pytest.approx(0.01 * along)
    assert trajectory["t_rel_percent"] == pytest.approx(1.00457242)
    assert trajectory["rpe_trans_rmse_m"] == pytest.approx(0.01)
    assert metrics["frames"] == {
        **{"total": 901, "tracked": 901, "lost": 0, "lost_stretches": []},
        **{"outside": 0, "without_truth": 0},
    }
    assert (metrics["protocol"]["alignment"], metrics["protocol"]["matched_by"]) == ("se3", "line")


def test_alignments_differ_as_they_should(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A scale error is all there is: sim3 finds it, and says so; none lets it grow to 9 m at the end."""
    truth, estimate = write_poses(tmp_path / "gt.txt", 901), write_poses(tmp_path / "estimate.txt", 901, 1.01)
    files = ("--trajectory", estimate, "--ground-truth", truth, "--alignment")
    sim3 = scored(capsys, *files, "sim3")
    assert sim3["trajectory"]["scale"] == pytest.approx(1 / 1.01)
    assert sim3["trajectory"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert sim3["trajectory"]["t_rel_percent"] == pytest.approx(0.0, abs=1e-9)
    assert "with scale" in sim3["protocol"]["trajectory"]
    none = scored(capsys, *files, "none")
    assert none["trajectory"]["ate_max_m"] == pytest.approx(9.0)
    assert none["protocol"]["alignment"] == "none"


@pytest.mark.parametrize(("sequence", "low", "high"), [("05", 0.77, 0.84), ("06", 0.73, 0.77), ("07", 0.46, 0.54)])
def test_real_orbslam2_runs(
    test_data: Path, sequence: str, low: float, high: float, capsys: pytest.CaptureFixture[str]
) -> None:
    estimate = test_data / "trajectories" / "orbslam2_stereo" / f"{sequence}_trial1.txt"
    truth = test_data / "kitti_odometry" / "poses" / f"{sequence}.txt"
    trajectory = scored(capsys, "--trajectory", estimate, "--ground-truth", truth)["trajectory"]
    assert low - 0.005 <= trajectory["ate_rmse_m"] <= high + 0.005
    # 07 is 695 m long.
    assert trajectory["segments_m"] == [100.0 * k for k in range(1, 7 if sequence == "07" else 9)]
    assert main(["score", "--trajectory", str(estimate), "--ground-truth", str(truth)]) == 0
    printed = capsys.readouterr().out
    assert re.search(rf"ATE \[m\] +│ {trajectory['ate_rmse_m']:.3f} ", printed)
    assert re.search(rf"static camera +│ {trajectory['static_camera_ate_rmse_m']:.3f} ", printed)


def test_the_picture_and_what_was_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [f"{0.1 * i:.1f} 0 0 {i} 0 0 0 1\n" for i in range(60)]
    (tmp_path / "gt").write_text("".join(lines))
    (tmp_path / "estimate").write_text("".join(lines[:20] + lines[25:]))
    files = ["--trajectory", str(tmp_path / "estimate"), "--ground-truth", str(tmp_path / "gt")]
    assert main(["score", *files, "--plot", str(tmp_path / "plot.png")]) == 0
    printed = capsys.readouterr().out
    assert "55/60" in printed
    assert "estimate: 5 frames lost (20 to 24)" in printed
    assert re.search(r"segments: 39 of 10 m, .*; \d+ lost", printed)
    picture = cv2.imread(str(tmp_path / "plot.png"))
    assert picture.shape[1] > picture.shape[0] > 400


@pytest.mark.parametrize(
    ("estimate", "truth", "options", "message"),
    [
        ("good", "nowhere", [], r"nowhere does not exist\. Check the path"),
        ("nowhere", "good", [], r"nowhere does not exist\. Check the path"),
        ("good", "longer", [], r"good has 20 poses and \S*longer has 30\. KITTI files are matched line by line"),
        ("tum", "good", [], r"good is a KITTI file, which has no times, .*--times FILE"),
        ("nan", "good", [], r"nan has 2 poses and good has 20"),
        ("empty", "good", [], r"empty holds no pose"),
        ("good", "good", ["--plot", "plot.pdf"], r"--plot plot\.pdf: the picture is a PNG"),
        ("good", "good", ["--plot", "no/folder/plot.png"], r"Can't write no/folder/plot\.png: No such file"),
        ("good", "good", ["--frames", "x"], r"--frames 'x' is no range of frames"),
        ("good", "good", ["--max-time-difference", "-1"], r"--max-time-difference -1\.0 must be"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(
    estimate: str,
    truth: str,
    options: list[str],
    message: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_poses(tmp_path / "good", 20)
    write_poses(tmp_path / "longer", 30)
    (tmp_path / "nan").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 nan 0 1 0 0 0 0 1 0\n")
    (tmp_path / "tum").write_text("0 0 0 0 0 0 0 1\n")
    (tmp_path / "empty").touch()
    before = sorted(tmp_path.iterdir())
    assert main(["score", "--trajectory", estimate, "--ground-truth", truth, *options]) == 2
    out, error = capfd.readouterr()
    assert re.fullmatch(rf"bgs-bench: .*{message}.*\n", error), error
    assert out == ""
    assert sorted(tmp_path.iterdir()) == before
