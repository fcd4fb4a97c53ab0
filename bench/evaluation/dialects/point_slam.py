"""Point-SLAM's rules: PSNR of the pixels that have a depth, every fifth frame."""

from __future__ import annotations

import numpy as np

from bench.evaluation.dialects import loopsplat, splatam
from bench.evaluation.dialects.dialect import Dialect, Flags, Numbers, joint_psnr_db
from bench.evaluation.ssim_flavours import MS_SSIM_MINIMUM_SIDE, Color
from bench.types import Mask

EVERY = 5
"""Its step between mapped frames, which are the scored ones, as set for Replica."""


def psnr_db(render: Color, image: Color, known: Mask | None) -> float:
    """Joint over the channels of the pixels of known reference depth; NaN where there is none."""
    return float("nan") if known is None else joint_psnr_db(render[known], image[known])


def scores_view(positions: Numbers, mapped: Flags, frames: int) -> Flags:
    """Every fifth frame from the first one, whether the map was made from them or not."""
    return np.asarray(positions % EVERY == 0)


POINT_SLAM = Dialect(
    "point_slam",
    psnr_db,
    loopsplat.ssim,
    ssim_minimum_side=MS_SSIM_MINIMUM_SIDE,
    needs_depth=True,
    lpips_is_masked=False,
    depth_l1_m=splatam.depth_l1_m,
    ate_m=loopsplat.ate_m,
    scores_view=scores_view,
    stamp={
        "views": f"every {EVERY}th frame from the first one",
        "mask": "pixels without reference depth don't count for PSNR",
        "psnr": "joint over channels of pixels of known reference depth",
        "ssim": "MS-SSIM, whole image",
        "lpips": "alex, whole image",
        "depth_l1": "pixels of known reference depth, holes count as depth 0",
        "ate": "RMSE of all frames' centres, SE(3), no scale",
    },
)
