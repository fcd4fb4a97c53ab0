"""Depth-L1: rendered depth against LiDAR."""

from __future__ import annotations

import numpy as np

from bench.contracts.saved_run import SavedView
from bench.errors import BenchError
from bench.evaluation.lidar_occlusion import unoccluded
from bench.protocol import Protocol
from bench.types import Map


def depth_reference(view: SavedView, protocol: Protocol) -> Map | None:
    """What a view's depth is compared with, (H, W) float32 in metres, NaN = unknown: LiDAR, else the depth camera's.

    None where the data set knows neither. LiDAR is without what the protocol's mask leaves out.
    """
    reference = view.lidar
    if reference is None:
        return view.sensor_depth
    if protocol.depth_mask == "unoccluded":  # a depth camera sees what the other one sees, a scanner on top not
        reference = np.where(unoccluded(reference), reference, np.float32(np.nan))
    return reference


def depth_l1_cm(rendered: Map, lidar: Map, min_m: float, max_m: float | None) -> tuple[float, int]:
    """Mean absolute difference in centimetres over the pixels with a LiDAR return, and how many pixels those are.

    Both maps are (H, W) float32 in metres, NaN = unknown. Returns count when ``min_m < depth < max_m`` (None: no cap);
    the rendered depth is not limited. A pixel where nothing was rendered (NaN or 0) counts as depth 0, its full LiDAR
    depth as error: leaving it out would reward holes. NaN and 0 when no pixel counts.
    Source: the paper's "Depth L1", on the mask and range that it leaves open.

    >>> lidar = np.array([[10.0, 20.0, np.nan, 90.0]], np.float32)
    >>> rendered = np.array([[10.5, 19.75, 7.0, np.nan]], np.float32)
    >>> depth_l1_cm(rendered, lidar, 0.0, 80.0)  # 50 cm and 25 cm off; the third has no return, the fourth is too far
    (37.5, 2)
    """
    if rendered.shape != lidar.shape:
        raise BenchError(
            f"The rendered depth is {rendered.shape[1]}x{rendered.shape[0]} and the LiDAR depth "
            f"{lidar.shape[1]}x{lidar.shape[0]}; they must be of the same size. Check that the run fits the data set."
        )
    counts = lidar > min_m if max_m is None else (lidar > min_m) & (lidar < max_m)
    truth = lidar[counts].astype(np.float64)
    if not len(truth):
        return float("nan"), 0
    depth = np.nan_to_num(rendered[counts].astype(np.float64), nan=0.0)
    return float(100.0 * np.mean(np.abs(depth - truth))), len(truth)
