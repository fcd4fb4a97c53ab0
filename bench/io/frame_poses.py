"""Ground-truth poses beside images: which pose is whose, by time, by the number in the name, or line by line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.geometry import se3
from bench.io.frame_names import NamedFiles, nearest, seconds_per_unit
from bench.io.text_files import read_text
from bench.io.trajectories import known_poses, read_kitti_poses, read_tum_lines, values_per_line
from bench.types import Float

_SAME_S = 0.01
"""A pose this near in time is the image's own where no two poses can be interpolated, as where trajectories are
matched by time elsewhere."""
_EXACT_S = 1e-6
_OUTAGE = 1.5
"""Between poses farther apart than so many of their usual steps some are missing: nothing is interpolated there."""
_LONGEST_S = 0.3
"""A car's motion over a longer time is no ground truth when it is interpolated."""


@dataclass(frozen=True)
class ImagePoses:
    """Poses ``T_world_cam`` (N, 4, 4) of N images, NaN where there is none, and the ``times`` (N,) of a file that gives
    them. ``remarks`` says what a user should know of how they were found."""

    T_world_cam: Float
    times: Float | None
    remarks: tuple[str, ...]


def poses_of_images(path: Path, images: NamedFiles, times: Float | None) -> ImagePoses:
    """The poses that a KITTI or TUM file has of ``images``, whose ``times`` (N,) in seconds are known or None.

    A TUM file is joined by time where the images have times. Otherwise line i is image i where there are as many lines
    as images, and of KITTI's format line k is the image with number k (from 0) where there are more. Raises
    ``BenchError`` for every other number of lines.
    """
    columns = values_per_line(path, "pose file")
    if columns not in (8, 12):
        raise BenchError(f"{path} has {columns} values in its first line; KITTI has 12 and TUM 8. Convert it.")
    if columns == 12:
        T = read_kitti_poses(path)
        rows, remarks = rows_of_images(len(T), images, path, "poses")
        return ImagePoses(T[rows], None, remarks)
    pose_times, T = read_tum_lines(path)
    pose_times = pose_times * float(seconds_per_unit(pose_times))
    if times is not None:
        return ImagePoses(poses_at_times(path, pose_times, T, times), None, ())
    if len(T) != len(images.files):
        raise BenchError(
            f"{path} has {len(T)} poses by time for {len(images.files)} images without times. Give the images' times, "
            "dataset.times=FILE with one a line, or a file with one pose an image."
        )
    return ImagePoses(T, pose_times, ())


def read_times(path: Path, images: NamedFiles) -> tuple[Float, tuple[str, ...]]:
    """Times (N,) in seconds of ``images`` from a file with one a line, the first column where it is a table, and
    remarks; ns, us and ms are recognised.

    Lines are joined with images as those of KITTI poses. ``BenchError`` for what is no time or does not increase.
    """
    lines = read_text(path, "file of times").rstrip().splitlines()
    if lines and re.match(r"[A-Za-z_]", lines[0]):  # the columns' names
        del lines[0]
    try:
        times = np.array([float(re.split(r"[\s,]", line.strip())[0]) for line in lines if not line.startswith("#")])
    except ValueError:
        raise BenchError(f"{path}: not every line begins with a time in seconds, one an image.") from None
    rows, remarks = rows_of_images(len(times), images, path, "times")
    times = times[rows]
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise BenchError(f"{path}: the times do not increase from image to image. Restore the file.")
    return times * float(seconds_per_unit(times)), remarks


def rows_of_images(
    lines: int, images: NamedFiles, path: Path, what: str
) -> tuple[npt.NDArray[np.int64], tuple[str, ...]]:
    """Which of a file's ``lines`` belongs to each image (N,), and a remark where that is not one after the other."""
    count, numbers = len(images.files), images.numbers
    if lines == count:
        return np.arange(count), ()
    if numbers is not None and numbers[-1] < lines and numbers[0] != 1:
        return numbers, (
            f"{path.name} has {lines} {what} for {count} images: line k (from 0) is taken for image number k",
        )
    named = "names without a number" if numbers is None else f"numbers {numbers[0]} to {numbers[-1]} in their names"
    if numbers is not None and numbers[0] == 1:
        named += ", whose first may be that of the first line or of the second"
    raise BenchError(
        f"{path} has {lines} {what}, but there are {count} images, with {named}. Give one line an image, or one for "
        "every number from 0 to the last; a frame whose pose is unknown is a line of twelve nan."
    )


def poses_at_times(path: Path, pose_times: Float, T: Float, wanted: Float) -> Float:
    """Poses (N, 4, 4) at the ``wanted`` times: own ones, or between two neighbours; NaN where there is none.

    Raises ``BenchError``, which names the file ``path``, where that is so of all.
    """
    known = known_poses(T)
    times, T = pose_times[known], T[known]
    place = nearest(times, wanted)
    apart = np.abs(times[place] - wanted)
    poses = np.full((len(wanted), 4, 4), np.nan)
    own = apart <= _EXACT_S
    between = np.zeros(len(wanted), dtype=bool)
    if len(times) > 1:
        longest = min(_OUTAGE * float(np.median(np.diff(pose_times))), _LONGEST_S)
        after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
        step = times[after] - times[after - 1]
        between = ~own & (times[after - 1] < wanted) & (wanted < times[after]) & (step <= longest)
        after, step = after[between], step[between]
        poses[between] = se3.interpolate(T[after - 1], T[after], (wanted[between] - times[after - 1]) / step)
    own |= ~between & (apart <= _SAME_S)
    poses[own] = T[place[own]]
    if not known_poses(poses).any():
        raise BenchError(
            f"{path}: its times {times[0]:.3f} to {times[-1]:.3f} s are nowhere near the images', {wanted[0]:.3f} to "
            f"{wanted[-1]:.3f} s. Use the same clock for both."
        )
    return poses
