"""SplaTAM's rules: images masked by reference depth, the ATE of something that is no camera centre."""

from __future__ import annotations

import numpy as np

from bench.evaluation.dialects.dialect import (
    Dialect,
    Flags,
    Numbers,
    masked,
    mean_channel_psnr_db,
    poses_in_common,
    rigid_errors_m,
)
from bench.evaluation.ssim_flavours import MS_SSIM_MINIMUM_SIDE, Color, ms_ssim
from bench.types import Float, Map, Mask, Trajectory

EVERY = 5
"""Its step between scored frames, as set for Replica."""


def psnr_db(render: Color, image: Color, known: Mask | None) -> float:
    """Mean over channels, over all pixels of both images painted black where no reference depth is known.

    The pixels painted black agree, so the number rises by 10 log10 of one over the share of known depth: 13 dB with
    a LiDAR that covers 5 % of the image. NaN where no depth is known.
    """
    if known is None or not known.any():
        return float("nan")
    return mean_channel_psnr_db(masked(render, known), masked(image, known))


def ssim(render: Color, image: Color, known: Mask | None) -> float:
    """MS-SSIM of the images painted black where no reference depth is known, reported as SSIM; NaN as above."""
    if known is None or not known.any():
        return float("nan")
    return ms_ssim(masked(render, known), masked(image, known))


def depth_l1_m(depth: Map, reference: Map) -> float:
    """Mean absolute difference over the pixels of known reference depth; a hole in the render counts as depth 0."""
    known = reference > 0
    if not known.any():
        return float("nan")
    rendered = np.nan_to_num(depth[known].astype(np.float64), nan=0.0)
    return float(np.mean(np.abs(rendered - reference[known])))


def ate_m(estimate: Trajectory, ground_truth: Trajectory, keyframes: Numbers) -> float | str:
    """Mean distance of the last columns of the world-to-camera matrices, ground truth aligned to the estimate.

    These columns are -R'C and not the camera centres C, so that a wrong scale can go unseen on a circle.
    """
    _, T_estimate, T_truth = poses_in_common(estimate, ground_truth)
    errors = rigid_errors_m(_last_columns(T_truth), _last_columns(T_estimate))
    return errors if isinstance(errors, str) else float(errors.mean())


def _last_columns(T_world_cam: Float) -> Float:
    """Of the inverse matrices: -R'C of each pose (N, 4, 4)."""
    return -np.einsum("nji,nj->ni", T_world_cam[:, :3, :3], T_world_cam[:, :3, 3])


def scores_view(positions: Numbers, mapped: Flags, frames: int) -> Flags:
    """The first frame and then every fifth, whether the map was made from them or not (SplaTAM maps every frame)."""
    return np.asarray((positions == 0) | ((positions + 1) % EVERY == 0))


SPLATAM = Dialect(
    "splatam",
    psnr_db,
    ssim,
    ssim_minimum_side=MS_SSIM_MINIMUM_SIDE,
    needs_depth=True,
    lpips_is_masked=True,
    depth_l1_m=depth_l1_m,
    ate_m=ate_m,
    scores_view=scores_view,
    stamp={
        "views": f"the first frame and every {EVERY}th after it",
        "mask": "both images black where no reference depth is known, and those pixels counted",
        "psnr": "mean over channels of each channel's PSNR, masked",
        "ssim": "MS-SSIM, masked",
        "lpips": "alex, masked",
        "depth_l1": "pixels of known reference depth, holes count as depth 0",
        "ate": "mean error of the last column of world-to-camera matrices, SE(3), ground truth aligned to estimate",
    },
)
