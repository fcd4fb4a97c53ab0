"""LoopSplat's rules: keyframes alone are scored, and depth also where there is no reference."""

from __future__ import annotations

import numpy as np

from bench.evaluation.dialects.dialect import Dialect, Flags, Numbers, joint_psnr_db, poses_in_common, rigid_errors_m
from bench.evaluation.ssim_flavours import MS_SSIM_MINIMUM_SIDE, Color, ms_ssim
from bench.types import Map, Mask, Trajectory


def psnr_db(render: Color, image: Color, known: Mask | None) -> float:
    """Joint over all pixels and channels."""
    return joint_psnr_db(render, image)


def ssim(render: Color, image: Color, known: Mask | None) -> float:
    """MS-SSIM of the whole image, reported as SSIM."""
    return ms_ssim(render, image)


def depth_l1_m(depth: Map, reference: Map) -> float:
    """Mean absolute difference over all pixels, an unknown reference depth taken for 0.

    With LiDAR, which knows few pixels, this is little else than the mean of the rendered depth.
    """
    return float(np.mean(np.abs(np.nan_to_num(depth.astype(np.float64)) - np.nan_to_num(reference))))


def ate_m(estimate: Trajectory, ground_truth: Trajectory, keyframes: Numbers) -> float | str:
    """RMSE of all frames' centres after SE(3) alignment."""
    _, T_estimate, T_truth = poses_in_common(estimate, ground_truth)
    errors = rigid_errors_m(T_estimate[:, :3, 3], T_truth[:, :3, 3])
    return errors if isinstance(errors, str) else float(np.sqrt(np.mean(errors**2)))


def scores_view(positions: Numbers, mapped: Flags, frames: int) -> Flags:
    """The keyframes, from which the map was made."""
    return mapped


LOOPSPLAT = Dialect(
    "loopsplat",
    psnr_db,
    ssim,
    ssim_minimum_side=MS_SSIM_MINIMUM_SIDE,
    needs_depth=False,
    lpips_is_masked=False,
    depth_l1_m=depth_l1_m,
    ate_m=ate_m,
    scores_view=scores_view,
    stamp={
        "views": "keyframes, from which the map was made",
        "mask": "none",
        "psnr": "joint over pixels and channels",
        "ssim": "MS-SSIM, whole image",
        "lpips": "alex, whole image",
        "depth_l1": "all pixels, unknown reference depth taken for 0",
        "ate": "RMSE of all frames' centres, SE(3), no scale",
    },
)
