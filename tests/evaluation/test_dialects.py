"""The dialects of other systems' evaluators on cases worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from evo.core.geometry import GeometryException, umeyama_alignment

from bench.evaluation.dialects import loopsplat, monogs, point_slam, splatam
from bench.evaluation.dialects.catalogue import DIALECTS
from bench.evaluation.dialects.dialect import joint_psnr_db, mean_channel_psnr_db
from bench.evaluation.ssim_flavours import Color
from bench.types import Map, Trajectory

Float = npt.NDArray[np.float64]
NONE = np.array([], dtype=np.int64)


def grey(*rows: list[float]) -> Color:
    return np.repeat(np.array(rows, np.float32)[..., None], 3, axis=2)


def depth(*rows: list[float]) -> Map:
    return np.array(rows, np.float32)


# One frame of 2x2 pixels; 0 is an unknown reference depth.
IMAGE, RENDER = grey([0, 0.5], [0.5, 0.5]), grey([0.5, 0.6], [0.6, 0.6])
REFERENCE, DEPTH = depth([0, 10], [20, 0]), depth([5, 12], [18, 7])


def path(centres: Float, rotations: Float | None = None) -> Trajectory:
    T = np.tile(np.eye(4), (len(centres), 1, 1))
    T[:, :3, 3] = centres
    if rotations is not None:
        T[:, :3, :3] = rotations
    return Trajectory(T, np.arange(len(centres)), 0.1 * np.arange(len(centres)))


def about_z(angle: float) -> Float:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def test_channels_apart_or_together() -> None:
    """Errors .1, .05 and .2: together 0.0175 = 17.57 dB, apart (20 + 26.02 + 13.98) / 3 = 20 dB."""
    image = np.full((2, 2, 3), 0.5, np.float32)
    render = image + np.array([0.1, 0.05, 0.2], np.float32)
    assert joint_psnr_db(render, image) == pytest.approx(17.569620, abs=1e-5)
    assert mean_channel_psnr_db(render, image) == pytest.approx(20.0, abs=1e-5)
    exact_red = image + np.array([0.0, 0.05, 0.2], np.float32)
    assert mean_channel_psnr_db(exact_red, image) == math.inf
    assert math.isfinite(joint_psnr_db(exact_red, image))


def test_psnr_of_one_frame_by_four_rules() -> None:
    """Joint (.25 + 3 * .01) / 4 = .07; without the black pixel .01; SplaTAM (.01 + .01) / 4 = .005; Point-SLAM's two
    pixels with depth .01."""
    known = REFERENCE > 0
    assert loopsplat.psnr_db(RENDER, IMAGE, known) == pytest.approx(11.5490, abs=1e-4)
    assert monogs.psnr_db(RENDER, IMAGE, known) == pytest.approx(20.0, abs=1e-5)
    assert splatam.psnr_db(RENDER, IMAGE, known) == pytest.approx(23.0103, abs=1e-4)
    assert point_slam.psnr_db(RENDER, IMAGE, known) == pytest.approx(20.0, abs=1e-5)
    assert math.isnan(point_slam.psnr_db(RENDER, IMAGE, known & False))


def test_a_mask_painted_black_lifts_the_number() -> None:
    """Error .1 everywhere is 20 dB; a quarter of known depth makes 26.02 of it, none makes nothing."""
    image, render = grey([0.5, 0.5], [0.5, 0.5]), grey([0.6, 0.6], [0.6, 0.6])
    assert loopsplat.psnr_db(render, image, None) == pytest.approx(20.0, abs=1e-5)
    assert splatam.psnr_db(render, image, depth([3, 0], [0, 0]) > 0) == pytest.approx(26.0206, abs=1e-4)
    assert math.isnan(splatam.psnr_db(render, image, depth([0, 0], [0, 0]) > 0))
    assert math.isnan(splatam.ssim(render, image, depth([0, 0], [0, 0]) > 0))


def test_black_values_are_left_out_one_by_one() -> None:
    """Two black pixels with error .5, two others with .1: 20 dB, not 8.86; of a red pixel only the red counts."""
    image, render = grey([0, 0], [0.5, 0.5]), grey([0.5, 0.5], [0.6, 0.6])
    assert monogs.psnr_db(render, image, None) == pytest.approx(20.0, abs=1e-5)
    assert loopsplat.psnr_db(render, image, None) == pytest.approx(8.860566, abs=1e-5)
    red = np.array([[[0.5, 0.0, 0.0]]], np.float32)
    assert monogs.psnr_db(red + np.float32(0.1), red, None) == pytest.approx(20.0, abs=1e-5)
    assert math.isnan(monogs.psnr_db(red, 0 * red, None))


def test_identical_images_are_infinite() -> None:
    assert loopsplat.psnr_db(IMAGE, IMAGE, None) == monogs.psnr_db(IMAGE, IMAGE, None) == math.inf


def test_ssim_is_another_thing_in_each() -> None:
    """.5 against .6 on 176x176: MS-SSIM .9977994; on 32x32 the zero-padded one .97626310; one half masked: black."""
    image, render = np.full((176, 176, 3), 0.5, np.float32), np.full((176, 176, 3), 0.6, np.float32)
    everywhere = np.ones((176, 176), bool)
    assert loopsplat.ssim(render, image, None) == pytest.approx(0.9977994, abs=5e-6)
    assert splatam.ssim(render, image, everywhere) == pytest.approx(0.9977994, abs=5e-6)
    left = np.arange(176) < 88
    half = splatam.ssim(render, image, everywhere & left)
    painted = [picture * left[None, :, None].astype(np.float32) for picture in (render, image)]
    assert half == loopsplat.ssim(*painted, None)
    assert half != pytest.approx(0.9977994, abs=1e-4)
    assert monogs.ssim(render[:32, :32], image[:32, :32], None) == pytest.approx(0.97626310, abs=1e-5)


@pytest.mark.parametrize("unknown", [0.0, np.nan])
def test_depth_of_one_frame_by_two_rules(unknown: float) -> None:
    """Known pixels (2 + 2) / 2; all of them (5 + 2 + 2 + 7) / 4. NaN is our way to say unknown."""
    reference = np.where(REFERENCE == 0, np.float32(unknown), REFERENCE)
    assert splatam.depth_l1_m(DEPTH, reference) == pytest.approx(2.0)
    assert loopsplat.depth_l1_m(DEPTH, reference) == pytest.approx(4.0)


def test_a_hole_in_the_render_counts_as_depth_zero() -> None:
    reference, rendered = depth([2, 0, 10, 50, 5]), depth([2.5, 3, 8, 90, np.nan])
    assert splatam.depth_l1_m(rendered, reference) == pytest.approx(11.875)
    assert loopsplat.depth_l1_m(rendered, reference) == pytest.approx(10.1)
    assert math.isnan(splatam.depth_l1_m(rendered, 0 * reference))
    assert monogs.MONOGS.depth_l1_m is None


def eight_points() -> tuple[Trajectory, Trajectory]:
    """(+-1, +-1, 0) and (+-2, +-2, 0); the inner four of the estimate are .4 up or down, by the sign of x y."""
    truth = np.array([(s * x, s * y, 0.0) for s in (1, 2) for x in (-1, 1) for y in (-1, 1)])
    estimate = truth.copy()
    estimate[:4, 2] = 0.4 * np.sign(truth[:4, 0] * truth[:4, 1])
    return path(estimate), path(truth)


def test_rmse_or_mean_of_the_same_errors() -> None:
    """No rotation helps: errors .4 and 0, four times each: RMSE .4 / sqrt 2, mean .2; keyframes: the inner four."""
    estimate, truth = eight_points()
    assert loopsplat.ate_m(estimate, truth, NONE) == pytest.approx(0.282843, abs=1e-6)
    assert splatam.ate_m(estimate, truth, NONE) == pytest.approx(0.2, abs=1e-6)
    assert monogs.ate_m(estimate, truth, np.arange(4)) == pytest.approx(0.4, abs=1e-6)
    moved = path(estimate.T_world_cam[:, :3, 3] @ about_z(0.7).T + (5, -3, 2))
    assert loopsplat.ate_m(moved, truth, NONE) == pytest.approx(0.282843, abs=1e-6)
    assert monogs.ate_m(moved, truth, np.arange(8)) == pytest.approx(0.282843, abs=1e-6)


def test_splatams_columns_are_no_camera_centres() -> None:
    """Cameras on circles of radius 1 and 2 that look along them: wrong by a metre, and SplaTAM's number is 0."""
    rotations = np.array([about_z(k * np.pi / 2) for k in range(4)])
    truth, estimate = (path(rotations @ np.array([r, 0.0, 0.0]), rotations) for r in (1.0, 2.0))
    assert loopsplat.ate_m(estimate, truth, NONE) == pytest.approx(1.0)
    assert monogs.ate_m(estimate, truth, np.arange(4)) == pytest.approx(1.0)
    assert splatam.ate_m(estimate, truth, NONE) == pytest.approx(0.0, abs=1e-9)


def test_a_straight_line_of_keyframes_has_no_ate_in_evo() -> None:
    line = np.outer(np.arange(5.0), [0, 0, 1.0])
    with pytest.raises(GeometryException):
        umeyama_alignment(line.T, line.T)
    reason = monogs.ate_m(path(line), path(line), np.arange(5))
    assert reason == "the keyframes lie on a straight line, which this evaluator's alignment refuses"
    assert loopsplat.ate_m(path(line), path(line), NONE) == pytest.approx(0.0, abs=1e-9)


def test_evo_gives_the_same_number_for_keyframes() -> None:
    rng = np.random.default_rng(3)
    truth, estimate = rng.normal(size=(2, 20, 3))
    keyframes = np.arange(0, 20, 3)
    R, t, _ = umeyama_alignment(estimate[keyframes].T, truth[keyframes].T)
    expected = np.sqrt(np.mean(np.sum((estimate[keyframes] @ R.T + t - truth[keyframes]) ** 2, axis=1)))
    assert monogs.ate_m(path(estimate), path(truth), keyframes) == pytest.approx(expected)


def test_too_few_poses_are_said_and_infinite_ones_dropped() -> None:
    estimate, truth = eight_points()
    assert monogs.ate_m(estimate, truth, np.arange(2)) == (
        "only 2 poses to compare; at least 3 are needed (keyframes only)"
    )
    assert splatam.ate_m(path(np.zeros((2, 3))), truth, NONE) == "only 2 poses to compare; at least 3 are needed"
    broken = truth.T_world_cam.copy()
    broken[0, 0, 3] = np.inf
    lacking = Trajectory(broken, truth.numbers, truth.timestamps)
    assert loopsplat.ate_m(truth, lacking, NONE) == pytest.approx(0.0, abs=1e-9)


def test_which_views_each_one_scores() -> None:
    """12 frames, keyframes 0, 4, 5 and 11."""
    positions = np.arange(12)
    mapped = np.isin(positions, [0, 4, 5, 11])
    chosen = {d.name: positions[d.scores_view(positions, mapped, 12)].tolist() for d in DIALECTS}
    assert chosen == {"splatam": [0, 4, 9], "monogs": [10], "point_slam": [0, 5, 10], "loopsplat": [0, 4, 5, 11]}
    last = np.arange(11)
    assert last[monogs.scores_view(last, np.zeros(11, bool), 11)].tolist() == [0, 5], "10 is the last frame"


def test_every_dialect_says_its_rules() -> None:
    asked = {"views", "mask", "psnr", "ssim", "lpips", "depth_l1", "ate"}
    assert all(set(dialect.stamp) == asked for dialect in DIALECTS)
