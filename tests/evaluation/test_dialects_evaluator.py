"""The evaluator ``dialects`` on a run whose numbers follow from how it was written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from bench.contracts.saved_run import LpipsMetric, SavedRun
from bench.errors import BenchError
from bench.evaluation.dialects import splatam
from bench.evaluation.run_evaluators import evaluate_run
from bench.runs.folder import picture_path
from bench.types import Map, Trajectory
from plugins.evaluators import dialects as evaluator
from tests.evaluation.tiny_run import HEIGHT, LEFT_ERROR, NUMBERS, WIDTH, TinyConfig, TinyDataset, write_tiny_run


def psnr_of(*errors: int) -> float:
    return float(np.mean([20 * math.log10(255 / error) for error in errors]))


@pytest.fixture
def config(tiny_config: dict[str, Any]) -> dict[str, Any]:
    return tiny_config | {"evaluator": {"dialects": {"name": "dialects"}}}


def half_known(self: TinyDataset, position: int) -> Map | None:
    """12 m in the upper half of every frame, unknown below; frame 14 too, unlike the data set's own."""
    depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    depth[: HEIGHT // 2] = 12.0
    return depth


def test_all_views_under_each_dialect(tmp_path: Path, config: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Tracked 10, 11, 13 (held out, empty depth) and 14; depth 10 m, LiDAR 12 m in the upper half."""
    monkeypatch.setattr(TinyDataset, "lidar_depth", half_known)
    config["evaluator"]["dialects"]["views"] = "all"
    dialects = evaluate_run(write_tiny_run(tmp_path / "run", config))["dialects"]
    plain = psnr_of(*LEFT_ERROR.values())
    assert [part["n_views"] for part in dialects.values()] == [4, 4, 4, 4]
    assert dialects["loopsplat"]["psnr_db"] == pytest.approx(plain, abs=1e-4)
    assert dialects["splatam"]["psnr_db"] == pytest.approx(plain + 10 * math.log10(2), abs=1e-4)
    # Of 0 to 199, one value in 200 is black and left out: the error is the same elsewhere.
    assert dialects["monogs"]["psnr_db"] == pytest.approx(plain, abs=1e-4)
    assert dialects["splatam"]["depth_l1_cm"] == pytest.approx((3 * 200 + 1200) / 4)
    # Rendered 10 m: 2 m off above, 10 m "off" below; nothing rendered in the held-out frame: 12 m above, 0 below.
    assert dialects["loopsplat"]["depth_l1_cm"] == pytest.approx((3 * 600 + 600) / 4)
    assert dialects["point_slam"]["psnr_db"] == pytest.approx(plain, abs=0.3)  # of the upper half's noise
    assert dialects["point_slam"]["depth_l1_cm"] == dialects["splatam"]["depth_l1_cm"]
    assert dialects["monogs"]["depth_l1_cm"] is None
    assert dialects["monogs"]["ssim"] < 1
    assert dialects["splatam"]["ssim"] is dialects["loopsplat"]["ssim"] is None
    assert dialects["splatam"]["stamp"]["views"] == "all left views"


def test_depth_is_the_mean_of_frame_means(
    tmp_path: Path, config: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rendered 10 m: in frame 10 one return at 11 m, in the others three at 13 m, of which 13 has nothing rendered.
    Frame by frame (1 + 3 + 13 + 3) / 4; all returns together would be (1 + 9 + 39 + 9) / 10 = 5.8 m."""

    def few_returns(self: TinyDataset, position: int) -> Map:
        depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
        depth[0, : 1 if position == 0 else 3] = 11.0 if position == 0 else 13.0
        return depth

    monkeypatch.setattr(TinyDataset, "lidar_depth", few_returns)
    config["evaluator"]["dialects"]["views"] = "all"
    dialects = evaluate_run(write_tiny_run(tmp_path / "run", config))["dialects"]
    assert dialects["splatam"]["depth_l1_cm"] == pytest.approx(500.0)


def test_own_views_and_what_is_missing(tmp_path: Path, config: dict[str, Any]) -> None:
    """Places 0, 1, 3, 4 of five are tracked; 3 is held out, 4 has no scan. MonoGS: place 0 is a keyframe, no other."""
    metrics = evaluate_run(write_tiny_run(tmp_path / "run", config))
    dialects, note = metrics["dialects"], metrics["notes"]["dialects"]
    counts = {name: part["n_views"] for name, part in dialects.items()}
    assert counts == {"splatam": 2, "monogs": 0, "point_slam": 1, "loopsplat": 3}
    assert dialects["loopsplat"]["psnr_db"] == pytest.approx(psnr_of(1, 2, 4), abs=1e-4)
    assert dialects["splatam"]["psnr_db"] == pytest.approx(psnr_of(1) + 10 * math.log10(2), abs=1e-4)
    assert dialects["monogs"]["psnr_db"] is None
    assert "monogs: none of the run's left views is one that it scores" in note
    assert "splatam: 1 of 2 views have no PSNR" in note
    assert "loopsplat: 3 of 3 views have no SSIM" in note
    assert "loopsplat: 1 of 3 views have no Depth-L1" in note
    assert "monogs: the keyframes lie on a straight line" in note
    assert (dialects["splatam"]["ate_m"], dialects["monogs"]["ate_m"]) == (pytest.approx(0.0, abs=1e-9), None)
    assert dialects["loopsplat"]["stamp"]["ssim"] == "MS-SSIM, whole image"
    assert dialects["loopsplat"]["stamp"]["rendered_depth"] == "raw"
    assert metrics["notes"]["lpips"].startswith("switched off")
    json.dumps(metrics, allow_nan=False)


def test_an_exact_view_has_no_finite_psnr(tmp_path: Path, config: dict[str, Any]) -> None:
    config["evaluator"]["dialects"]["views"] = "all"
    run = write_tiny_run(tmp_path / "run", config)
    exact = TinyDataset(TinyConfig()).frame(NUMBERS.index(10)).left
    cv2.imwrite(str(picture_path(run, "left", "color", 10)), exact[..., ::-1])
    metrics = evaluate_run(run)
    assert metrics["dialects"]["loopsplat"]["psnr_db"] is None
    assert "loopsplat: 1 of 4 views have an infinite PSNR" in metrics["notes"]["dialects"]


def test_a_run_without_renders_keeps_its_trajectory(tmp_path: Path, config: dict[str, Any]) -> None:
    run = write_tiny_run(tmp_path / "run", config, state="interrupted")
    for number in LEFT_ERROR:
        picture_path(run, "left", "color", number).unlink()
    dialects = evaluate_run(run)["dialects"]
    assert dialects["loopsplat"]["n_views"] == 0
    assert dialects["loopsplat"]["ate_m"] == pytest.approx(0.0, abs=1e-9)


def test_wrong_settings_and_sizes_are_named(tmp_path: Path, config: dict[str, Any]) -> None:
    config["evaluator"]["dialects"]["views"] = "mine"
    with pytest.raises(BenchError, match=r"evaluator\.dialects\.views='mine' is not one of own, all"):
        evaluate_run(write_tiny_run(tmp_path / "run", config))


def test_evaluating_again_gives_the_same_bytes(tmp_path: Path, config: dict[str, Any]) -> None:
    run = write_tiny_run(tmp_path / "run", config)
    evaluate_run(run)
    first = (run / "metrics.json").read_bytes()
    evaluate_run(run)
    assert (run / "metrics.json").read_bytes() == first


@pytest.mark.parametrize("place", ["", "before", "after"])
def test_masked_lpips_sees_black_where_no_depth_is_known(
    tmp_path: Path, config: dict[str, Any], monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """A stand-in that compares mean brightness: half of the image is black for SplaTAM, none for LoopSplat.

    The evaluator ``image`` needs that of its 8 views, left and right; none is computed twice, whoever comes first.
    """
    monkeypatch.setattr(TinyDataset, "lidar_depth", half_known)
    seen: list[bool] = []

    def brightness(images: Any, references: Any) -> list[float]:
        seen.append(not images[0][HEIGHT // 2 :].any() and not references[0][HEIGHT // 2 :].any())
        return [float(images[0].mean() - references[0].mean())]

    monkeypatch.setattr("bench.evaluation.run_lpips.lpips_of", lambda run: LpipsMetric(brightness))
    config["evaluator"]["dialects"]["views"] = "all"
    image = {"image": {"name": "image"}}
    config["evaluator"] = {"": {}, "before": image}.get(place, {}) | config["evaluator"]
    config["evaluator"] |= image if place == "after" else {}
    dialects = evaluate_run(write_tiny_run(tmp_path / "run", config))["dialects"]
    mean_error = np.mean(list(LEFT_ERROR.values()))
    assert dialects["loopsplat"]["lpips"] == dialects["monogs"]["lpips"] == pytest.approx(mean_error)
    assert dialects["splatam"]["lpips"] == pytest.approx(mean_error / 2)
    assert seen.count(True) == 4, "SplaTAM's"
    assert seen.count(False) == (8 if place else 4)


def test_splatams_columns_are_of_poses_relative_to_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """A turning path seen from a world 20 m away has no error, although its own columns differ from those."""
    angle = 0.3 * np.arange(6)
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, 0, 0], T[:, 0, 2], T[:, 2, 0], T[:, 2, 2] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    T[:, :3, 3] = np.c_[angle, 0 * angle, angle**2]
    away = np.eye(4)
    away[:3, 3] = (-12.0, 15.0, -8.0)
    truth, estimate = (Trajectory(poses, np.arange(6), 0.1 * np.arange(6)) for poses in (away @ T, T))
    assert splatam.ate_m(estimate, truth, np.arange(6)) > 1.0
    monkeypatch.setattr(evaluator, "estimate_and_truth", lambda run: (estimate, truth))
    run = cast(SavedRun, SimpleNamespace(numbers=lambda *_: list(range(6))))
    assert evaluator._ate(run, splatam.SPLATAM) == pytest.approx(0.0, abs=1e-9)
