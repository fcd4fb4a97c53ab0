"""What looks wrong in another system's output, by comparison with what the data set knows: hints, not verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.evaluation.hints import about_convention as of_pair
from bench.external.pictures import DepthFormat, read_depth
from bench.external.poses import WrittenPoses
from bench.external.settings import AXES, CONVENTIONS
from bench.geometry.axis_conventions import suspected_convention
from bench.geometry.pose_readings import alike, other_reading, step_error
from bench.types import Trajectory

Indices = npt.NDArray[np.intp]

_DEPTH_SAMPLES = 8
_IMPLAUSIBLE = 3.0
"""Depth that is off from LiDAR by more than this factor in the median is taken for depth in another unit."""


def about_convention(
    written: WrittenPoses, estimate: Trajectory, rows: Indices, truth: Trajectory | None
) -> str | None:
    """A hint that the poses are in another convention than they were read in, or None.

    ``estimate`` is how they were read, ``rows`` (N,) which of the file's poses those are. With ground truth the reading
    whose steps fit it clearly best is named; without, the direction in which the camera drives decides.
    """
    if truth is None:
        found = suspected_convention(estimate.T_world_cam)
        return None if found is None else f"{found}. Say --convention or --axes if that is so"
    known = np.isin(estimate.numbers, truth.numbers)
    T, wanted = estimate.T_world_cam[known], truth.T_world_cam[np.isin(truth.numbers, estimate.numbers)]
    reading = other_reading(T, wanted)
    if reading is None:
        return None
    errors = {
        (convention, axes): step_error(written.camera_to_world(convention, axes)[rows[known]], wanted)
        for convention, axes in product(CONVENTIONS[1:], AXES[1:])
    }
    convention, axes = min(errors, key=lambda option: errors[option])
    if not alike(errors[convention, axes], reading.error):
        return of_pair(T, wanted)
    return (
        f"read as {convention.replace('_', ' ')} in {axes} axes, the poses' steps are off the ground truth's by "
        f"{errors[convention, axes]:.1%} of their length, as they were read by {reading.error_as_is:.0%}. If that is "
        f"what they are: --convention {convention} --axes {axes}"
    )


def check_depth_unit(files: Mapping[int, Path], form: DepthFormat, dataset: Dataset) -> str | None:
    """What the unit of depth files (by position) seems to be against LiDAR; None where all is well, or nobody knows.

    Raises ``BenchError`` for depth that is off by a large factor, unless the user gave the scale: then it is told.
    """
    ratios = []
    chosen = sorted(files)[:: max(1, len(files) // _DEPTH_SAMPLES)]
    for position in chosen:
        lidar = dataset.lidar_depth(position)
        if lidar is None:
            continue
        depth = read_depth(files[position], (dataset.camera.width, dataset.camera.height), form)
        of_frame = depth / lidar
        ratios.append(of_frame[np.isfinite(of_frame)])
    together = np.concatenate(ratios) if ratios else np.zeros(0)
    if not len(together):
        return None
    ratio = float(np.median(together))
    if 1 / _IMPLAUSIBLE < ratio < _IMPLAUSIBLE:
        return None
    scale = form.scale_of(files[chosen[0]])
    text = (
        f"the depth is {ratio:.3g} times LiDAR's in the median; --depth-scale {scale * ratio:.3g} would make them "
        f"agree (it is {scale:g})"
    )
    if not form.asked:
        where = files[chosen[0]].parent
        raise BenchError(f"{where}: {text}. Say --depth-scale; --depth-scale {scale:g} scores the depth as it is.")
    return text
