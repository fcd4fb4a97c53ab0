"""What an evaluator's dialect consists of, and the parts that several of them share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.evaluation.ssim_flavours import Color
from bench.evaluation.trajectory import MINIMUM_FRAMES, common_frames, umeyama
from bench.types import Float, Map, Mask, Trajectory

Flags = npt.NDArray[np.bool_]
Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Dialect:
    """The rules of one evaluator, as pure functions of one view or of a trajectory.

    Colours are (H, W, 3) float32 in [0, 1], depth maps (H, W) float32 metres; in a rendered depth 0 is "nothing", and
    the reference is known where it is finite and above 0.

    ``psnr_db(render, image, known)`` and ``ssim(render, image, known)`` get the mask of known reference depth, which
    is None where there is no reference; a dialect with ``needs_depth`` is not asked then, and images of less than
    ``ssim_minimum_side`` pixels on a side have no SSIM. ``lpips_is_masked``: both
    images are made black where the reference depth is not known. ``depth_l1_m(depth, reference)`` is None in a
    dialect that has no such number. ``ate_m(estimate, ground_truth, keyframes)`` gives metres, or the reason why there
    is none. ``scores_view(positions, mapped, frames)``: which of the frames at these ``positions`` (N,) of a sequence
    of ``frames`` are scored, when ``mapped`` (N,) of them were keyframes. ``stamp`` says all this in words.
    """

    name: str
    psnr_db: Callable[[Color, Color, Mask | None], float]
    ssim: Callable[[Color, Color, Mask | None], float]
    ssim_minimum_side: int
    needs_depth: bool
    lpips_is_masked: bool
    depth_l1_m: Callable[[Map, Map], float] | None
    ate_m: Callable[[Trajectory, Trajectory, Numbers], float | str]
    scores_view: Callable[[Numbers, Flags, int], Flags]
    stamp: Mapping[str, str]


def joint_psnr_db(render: Color, image: Color) -> float:
    """-10 log10 of the mean squared difference over all values, data range 1; infinite for equal ones, NaN for none."""
    if not image.size:
        return float("nan")
    difference = render.astype(np.float64) - image
    return _decibel(np.array([np.mean(difference * difference)]))


def mean_channel_psnr_db(render: Color, image: Color) -> float:
    """Mean over the channels of each channel's PSNR: never below the joint one, infinite when one channel is exact."""
    difference = render.astype(np.float64) - image
    return _decibel(np.mean(difference * difference, axis=(0, 1)))


def masked(color: Color, known: Mask) -> Color:
    """Black where the mask is False."""
    return color * known[..., None].astype(np.float32)


def rigid_errors_m(moved: Float, fixed: Float) -> Float | str:
    """Distances (N,) in metres of points (N, 3) after the best rotation and translation of ``moved``, or why not."""
    if len(moved) < MINIMUM_FRAMES:
        return f"only {len(moved)} poses to compare; at least {MINIMUM_FRAMES} are needed"
    R, t, _ = umeyama(moved, fixed)
    return np.asarray(np.linalg.norm(moved @ R.T + t - fixed, axis=1))


def poses_in_common(estimate: Trajectory, ground_truth: Trajectory) -> tuple[Numbers, Float, Float]:
    """Numbers (N,) and both poses (N, 4, 4) of the frames that both have, without those that are not finite."""
    numbers, here, there = common_frames(estimate, ground_truth)
    T_estimate, T_truth = estimate.T_world_cam[here], ground_truth.T_world_cam[there]
    finite = np.isfinite(T_estimate).all(axis=(1, 2)) & np.isfinite(T_truth).all(axis=(1, 2))
    return numbers[finite], T_estimate[finite], T_truth[finite]


def _decibel(squared_errors: Float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.mean(-10.0 * np.log10(squared_errors)))
