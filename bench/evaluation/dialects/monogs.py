"""MonoGS's rules: black values of the image don't count, the trajectory is that of the keyframes."""

from __future__ import annotations

import numpy as np

from bench.evaluation.dialects.dialect import Dialect, Flags, Numbers, joint_psnr_db, poses_in_common, rigid_errors_m
from bench.evaluation.ssim_flavours import RADIUS, Color, ssim_3dgs
from bench.types import Mask, Trajectory

EVERY = 5


def psnr_db(render: Color, image: Color, known: Mask | None) -> float:
    """Joint over the values (a pixel has three) where the image is not 0; NaN for a black image."""
    counts = image > 0
    return joint_psnr_db(render[counts], image[counts])


def ssim(render: Color, image: Color, known: Mask | None) -> float:
    """SSIM with zero padding, as in the code of 3D Gaussian Splatting, over the whole image."""
    return ssim_3dgs(render, image)


def ate_m(estimate: Trajectory, ground_truth: Trajectory, keyframes: Numbers) -> float | str:
    """RMSE of the keyframes' centres alone after SE(3) alignment; evo, which it uses, refuses a straight line."""
    numbers, T_estimate, T_truth = poses_in_common(estimate, ground_truth)
    is_keyframe = np.isin(numbers, keyframes)
    moved, fixed = T_estimate[is_keyframe, :3, 3], T_truth[is_keyframe, :3, 3]
    errors = rigid_errors_m(moved, fixed)
    if isinstance(errors, str):
        return f"{errors} (keyframes only)"
    covariance = (fixed - fixed.mean(axis=0)).T @ (moved - moved.mean(axis=0)) / len(moved)
    if np.count_nonzero(np.linalg.svd(covariance, compute_uv=False) > np.finfo(np.float64).eps) < 2:
        return "the keyframes lie on a straight line, which this evaluator's alignment refuses"
    return float(np.sqrt(np.mean(errors**2)))


def scores_view(positions: Numbers, mapped: Flags, frames: int) -> Flags:
    """Every fifth frame from the first one, neither keyframes nor the last one."""
    return np.asarray((positions % EVERY == 0) & (positions < frames - 1) & ~mapped)


MONOGS = Dialect(
    "monogs",
    psnr_db,
    ssim,
    ssim_minimum_side=2 * RADIUS + 1,
    needs_depth=False,
    lpips_is_masked=False,
    depth_l1_m=None,
    ate_m=ate_m,
    scores_view=scores_view,
    stamp={
        "views": f"every {EVERY}th frame that is no keyframe, without the last frame",
        "mask": "values of the image that are 0 don't count for PSNR",
        "psnr": "joint over values that are not 0 in the image",
        "ssim": "zero-padded window as in 3DGS",
        "lpips": "alex, whole image",
        "depth_l1": "none",
        "ate": "RMSE of keyframes' centres, SE(3), no scale",
    },
)
