"""Parts of images: by distance, by sky, and LiDAR returns that the camera can't see."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from bench.errors import BenchError
from bench.evaluation.lidar_occlusion import unoccluded
from bench.evaluation.regions import distance_bins, psnr_where, ssim_where
from bench.evaluation.run_evaluators import evaluate_run
from bench.types import Map, Mask
from tests.evaluation.tiny_run import HEIGHT, HELD_OUT, LEFT_ERROR, WIDTH, TinyDataset, write_tiny_run


def psnr_of(*errors: int) -> float:
    return float(np.mean([20 * math.log10(255 / error) for error in errors]))


def test_bins_hold_their_lower_edge_and_no_unknown_depth() -> None:
    depth = np.array([[0.0, 9.999, 10.0, 29.9], [30.0, 79.9, 80.0, np.nan]], np.float32)
    bins = distance_bins(depth, (0, 10, 30, 80))
    assert {name: np.flatnonzero(where).tolist() for name, where in bins.items()} == {
        "0-10m": [0, 1],
        "10-30m": [2, 3],
        "30-80m": [4, 5],
    }


def test_psnr_of_a_part_knows_nothing_of_the_rest() -> None:
    """Error 10 in one pixel of four and 50 elsewhere: 28.13 dB, not the 34.15 of an image painted black around it."""
    image = np.full((2, 2, 3), 100, np.uint8)
    render = image + np.array([[[10], [50]], [[50], [50]]], np.uint8)
    here = np.array([[True, False], [False, False]])
    assert psnr_where(render, image, here) == pytest.approx(psnr_of(10))
    assert psnr_where(render, image, ~here) == pytest.approx(psnr_of(50))
    assert psnr_where(image, render, here) == pytest.approx(psnr_of(10))
    assert math.isnan(psnr_where(render, image, here & ~here))
    assert psnr_where(image, image, here) == 100.0
    with pytest.raises(BenchError, match="a mask of 3x3 pixels can't be compared"):
        psnr_where(image, image, np.ones((3, 3), bool))


def test_ssim_of_a_part_is_the_mean_of_scikit_images_map() -> None:
    rng = np.random.default_rng(0)
    image, render = rng.integers(0, 256, (2, 30, 40, 3), dtype=np.uint8)
    here = rng.random((30, 40)) < 0.3
    _, full = structural_similarity(
        render / 255,
        image / 255,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
        full=True,
    )
    scored = np.zeros_like(here)
    scored[5:-5, 5:-5] = here[5:-5, 5:-5]
    assert ssim_where(render, image, here, "skimage-gaussian") == pytest.approx(full[scored].mean(), abs=1e-6)
    assert math.isnan(ssim_where(render, image, here & ~here, "3dgs"))
    border = np.zeros_like(here)
    border[0] = True
    assert math.isnan(ssim_where(render, image, border, "skimage-gaussian"))
    assert math.isfinite(ssim_where(render, image, border, "3dgs"))


def test_returns_beside_nearer_ones_are_dropped() -> None:
    """10 m in the middle: 12 m within 3 pixels is behind it, 4 pixels away not; 11 m is within 10 % of 10 m."""
    lidar = np.full((15, 15), np.nan, np.float32)
    lidar[7, 7], lidar[4, 10], lidar[7, 11], lidar[10, 7], lidar[7, 4] = 10.0, 12.0, 12.0, 11.0, 11.2
    expected = np.isfinite(lidar)
    expected[4, 10] = expected[7, 4] = False
    assert np.array_equal(unoccluded(lidar), expected)


@pytest.mark.slow
def test_an_unoccluded_mask_changes_depth_l1(
    tmp_path: Path, tiny_config: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The render is at 10 m everywhere. 12 m in the upper half, 40 m in a row below it, in reach of the upper half."""

    def two_surfaces(self: TinyDataset, position: int) -> Map:
        depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
        depth[:20], depth[20] = 12.0, 40.0
        return depth

    monkeypatch.setattr(TinyDataset, "lidar_depth", two_surfaces)
    plain = evaluate_run(write_tiny_run(tmp_path / "plain", tiny_config))["views"]["train"]
    tiny_config["protocol"]["depth_mask"] = "unoccluded"
    masked = evaluate_run(write_tiny_run(tmp_path / "masked", tiny_config))["views"]["train"]
    assert plain["depth_l1_cm"] == pytest.approx((20 * 200 + 3000) / 21)
    assert masked["depth_l1_cm"] == pytest.approx(200.0)


def upper_ten_rows(self: TinyDataset, position: int) -> Mask:
    sky = np.zeros((HEIGHT, WIDTH), bool)
    sky[:10] = True
    return sky


def test_regions_of_a_run(tmp_path: Path, tiny_config: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """The LiDAR is at 12 m in rows 0 to 19; errors are the same all over an image; depth 10 m, none when held out."""
    tiny_config["evaluator"] = {"regions": {"name": "regions"}}
    metrics = evaluate_run(write_tiny_run(tmp_path / "run", tiny_config))
    regions = metrics["regions"]
    assert regions["distance"] == "LiDAR"
    assert set(regions["left"]) == {"10-30m"}
    assert regions["left"]["10-30m"]["n"] == 3
    assert regions["left"]["10-30m"]["pixels"] == 3 * 20 * WIDTH
    assert regions["left"]["10-30m"]["psnr_db"] == pytest.approx(psnr_of(1, 2, 8))
    assert regions["left"]["10-30m"]["depth_l1_cm"] == pytest.approx((200 + 200 + 1200) / 3)
    assert regions["heldout"]["10-30m"]["depth_l1_cm"] == pytest.approx(1200.0)
    assert "right" not in regions
    assert metrics["notes"]["regions"] == "the data set does not know where its sky is"
    monkeypatch.setattr(TinyDataset, "true_sky", upper_ten_rows)
    tiny_config["evaluator"]["regions"]["edges_m"] = [0, 12, 13]
    left = evaluate_run(write_tiny_run(tmp_path / "sky", tiny_config))["regions"]["left"]
    assert set(left) == {"12-13m", "sky", "not_sky"}
    assert left["sky"] == {"n": 4, "pixels": 4 * 10 * WIDTH, "psnr_db": pytest.approx(psnr_of(*LEFT_ERROR.values()))}
    assert left["not_sky"]["pixels"] == 4 * 30 * WIDTH


def test_true_depth_goes_before_lidar(
    tmp_path: Path, tiny_config: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """True depth of 8 m in the left half and 50 m in the right one, against a render at 10 m."""

    def halves(self: TinyDataset, position: int) -> Map:
        return np.where(np.arange(WIDTH) < WIDTH // 2, 8.0, 50.0)[None].repeat(HEIGHT, 0).astype(np.float32)

    monkeypatch.setattr(TinyDataset, "true_depth", halves)
    tiny_config["evaluator"] = {"regions": {"name": "regions"}}
    regions = evaluate_run(write_tiny_run(tmp_path / "run", tiny_config))["regions"]
    assert regions["distance"] == "true depth"
    found = {name: region["depth_l1_cm"] for name, region in regions["train"].items()}
    assert found == {"0-10m": pytest.approx(200.0), "30-80m": pytest.approx(4000.0)}


@pytest.mark.parametrize("edges", [[10], [0, 10, 10], [-1, 5]])
def test_wrong_edges_are_named(tmp_path: Path, tiny_config: dict[str, Any], edges: list[float]) -> None:
    tiny_config["evaluator"] = {"regions": {"name": "regions", "edges_m": edges}}
    with pytest.raises(BenchError, match=r"evaluator\.regions\.edges_m=\[.*\] must be two or more increasing"):
        evaluate_run(write_tiny_run(tmp_path / "run", tiny_config))


def test_a_sky_left_out_changes_psnr_and_ssim(
    tmp_path: Path, tiny_config: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The true images get another colour in the sky, so that renders are wrong by 40 there, and as before below it."""
    tiny_config["evaluator"] = {"image": {"name": "image"}}
    tiny_config["protocol"] |= {"sky": "out", "right_view": False}
    run = write_tiny_run(tmp_path / "run", tiny_config)
    tiny_config["protocol"]["sky"] = "in"
    whole = write_tiny_run(tmp_path / "whole", tiny_config)
    refused = evaluate_run(run)
    assert refused["views"] == {}
    assert refused["notes"]["image"] == "the data set tiny does not know where its sky is; use protocol.sky=in"
    frame = TinyDataset.frame

    def other_sky(self: TinyDataset, position: int) -> Any:
        seen = frame(self, position)
        seen.left[:10] += np.uint8(40)
        return seen

    monkeypatch.setattr(TinyDataset, "frame", other_sky)
    monkeypatch.setattr(TinyDataset, "true_sky", upper_ten_rows)
    metrics = evaluate_run(run)
    assert metrics["views"]["left"]["psnr_db"] == pytest.approx(psnr_of(*LEFT_ERROR.values()))
    assert metrics["views"]["heldout"]["psnr_db"] == pytest.approx(psnr_of(LEFT_ERROR[HELD_OUT]))
    assert "right" not in metrics["views"]
    assert metrics["views"]["left"]["lpips"] is None
    assert metrics["notes"]["lpips"].startswith("LPIPS is of whole images")
    with_sky = evaluate_run(whole)["views"]["left"]
    assert with_sky["psnr_db"] < metrics["views"]["left"]["psnr_db"] - 3
    assert with_sky["ssim"] < metrics["views"]["left"]["ssim"]


@pytest.mark.parametrize("flavour", ["3dgs", "ms-ssim"])
def test_the_protocols_ssim_is_the_one_that_is_computed(
    tmp_path: Path, tiny_config: dict[str, Any], flavour: str
) -> None:
    """Zero padding lowers the SSIM of images that differ in brightness; 40 rows are too few for five scales."""
    tiny_config["evaluator"] = {"image": {"name": "image"}}
    plain = evaluate_run(write_tiny_run(tmp_path / "plain", tiny_config))["views"]["left"]
    tiny_config["protocol"]["ssim"] = flavour
    run = write_tiny_run(tmp_path / "run", tiny_config)
    if flavour == "ms-ssim":
        with pytest.raises(BenchError, match=r"MS-SSIM needs images of at least 161 pixels on a side; these are 56x40"):
            evaluate_run(run)
        return
    other = evaluate_run(run)["views"]["left"]
    assert other["psnr_db"] == plain["psnr_db"]
    assert other["ssim"] != plain["ssim"]
    assert other["ssim"] == pytest.approx(plain["ssim"], abs=0.02)
