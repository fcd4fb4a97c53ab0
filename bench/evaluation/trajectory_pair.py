"""Two trajectory files, an estimate and a ground truth, as trajectories whose frame numbers belong together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.evaluation.trajectory import MINIMUM_FRAMES
from bench.io.frame_range import parse_frame_range
from bench.io.kitti_files import read_kitti_times
from bench.io.trajectories import known_poses, read_kitti_poses, read_tum, values_per_line
from bench.types import Float, Trajectory

FORMATS = ("auto", "kitti", "tum")
_FORMAT_OF_COLUMNS = {12: "kitti", 8: "tum"}
_DENSER = 0.75
"""A ground truth whose time step is below this share of the estimate's is no list of the camera's frames."""


@dataclass(frozen=True)
class TrajectoryPair:
    """An estimate and a ground truth with frame numbers in common.

    The ground truth's frames are the sequence, from the first to the last frame that the estimate has; frames between
    them that it has not are lost. ``outside`` counts the ground truth's frames before and after it, and
    ``without_truth`` the estimate's poses that no ground truth belongs to. ``matched_by`` says how they were matched.
    """

    estimate: Trajectory
    ground_truth: Trajectory
    outside: int
    without_truth: int
    matched_by: str


def read_pair(
    estimate_path: Path,
    truth_path: Path,
    form: str = "auto",
    times_path: Path | None = None,
    max_time_difference_s: float = 0.01,
    frames: str = "",
) -> TrajectoryPair:
    """Read two files in KITTI's or TUM's format and find which poses belong together.

    Two KITTI files are matched line by line and need equally many lines, unless ``frames`` ("first:end[:step]") names
    the lines of the ground truth, counted from 0, that the estimate's lines are. Otherwise the nearest in time belong
    together, at most ``max_time_difference_s`` apart; a KITTI file beside a TUM file gets its times from
    ``times_path``, one per line. ``form`` is "kitti", "tum" or "auto" (by the values per line, for each file).
    Raises ``BenchError``, with file and line where it can, for what can't be read or matched.
    """
    formats = [detect_format(path) if form == "auto" else form for path in (estimate_path, truth_path)]
    if not (np.isfinite(max_time_difference_s) and max_time_difference_s > 0.0):
        raise BenchError(f"--max-time-difference {max_time_difference_s} must be a number of seconds above 0.")
    if formats == ["kitti", "kitti"]:
        if times_path is not None:
            raise BenchError("--times is of no use for two KITTI files, which are matched by line; leave it out.")
        return _match_lines(estimate_path, truth_path, frames)
    if frames:
        raise BenchError("--frames is for two KITTI files; a TUM file is matched by its times, so leave it out.")
    estimate, truth = (
        read_tum(path) if its_format == "tum" else _read_kitti_with_times(path, times_path)
        for path, its_format in zip((estimate_path, truth_path), formats, strict=True)
    )
    if formats == ["tum", "tum"] and times_path is not None:
        raise BenchError("--times is of no use for two TUM files, which have their own times; leave it out.")
    return _match_times(estimate, truth, max_time_difference_s, (estimate_path, truth_path))


def detect_format(path: Path) -> str:
    """ "kitti" or "tum", by the number of values in the file's first line; ``BenchError`` for any other number."""
    count = values_per_line(path)
    if count == 0:
        raise BenchError(f"{path} holds no pose. Expected one per line: 12 numbers (KITTI) or 8 (TUM).")
    if count not in _FORMAT_OF_COLUMNS:
        raise BenchError(
            f"{path} has {count} values in its first line; KITTI has 12 and TUM 8, separated by blanks. Convert it."
        )
    return _FORMAT_OF_COLUMNS[count]


def _match_lines(estimate_path: Path, truth_path: Path, frames: str) -> TrajectoryPair:
    estimate, truth = read_kitti_poses(estimate_path), read_kitti_poses(truth_path)
    numbers = np.arange(len(truth))
    if frames:
        numbers = _chosen(frames, len(truth), truth_path)
    if len(estimate) != len(numbers):
        chosen = f"--frames {frames} names {len(numbers)} of its lines" if frames else f"has {len(numbers)}"
        raise BenchError(
            f"{estimate_path} has {len(estimate)} poses and {truth_path} {chosen}. KITTI files are matched line by "
            "line: say with --frames FIRST:END which lines of the ground truth the trajectory is for (counted from 0, "
            "END left out), or give TUM files, whose times can be matched when frames were lost."
        )
    tracked, known = known_poses(estimate), known_poses(truth[numbers])
    return TrajectoryPair(
        estimate=_by_line(estimate[tracked], numbers[tracked]),
        ground_truth=_by_line(truth[numbers][known], numbers[known]),
        outside=len(truth) - len(numbers),
        without_truth=int((tracked & ~known).sum()),
        matched_by="line",
    )


def _by_line(T: Float, lines: npt.NDArray[np.int64]) -> Trajectory:
    return Trajectory(T, lines, lines.astype(np.float64))


def _chosen(frames: str, there: int, path: Path) -> npt.NDArray[np.int64]:
    wanted = parse_frame_range(frames, setting="--frames ")
    first, end, step = wanted if wanted is not None else (0, None, 1)
    numbers = np.arange(first, there if end is None else end, step)
    if not len(numbers) or numbers[-1] >= there:
        raise BenchError(f"--frames {frames} asks for lines that {path} lacks: it has {there}, counted from 0.")
    return numbers


def _read_kitti_with_times(path: Path, times_path: Path | None) -> Trajectory:
    if times_path is None:
        raise BenchError(
            f"{path} is a KITTI file, which has no times, and the other file is TUM's, which is matched by time. Give "
            "--times FILE with one time in seconds for each line of it (KITTI's times.txt), or two files of one format."
        )
    poses, times = read_kitti_poses(path), read_kitti_times(times_path)
    if len(times) != len(poses):
        raise BenchError(f"{times_path} has {len(times)} times and {path} {len(poses)} poses; one a pose is needed.")
    known = known_poses(poses)
    return Trajectory(poses[known], np.flatnonzero(known), times[known])


def _match_times(
    estimate: Trajectory, truth: Trajectory, tolerance_s: float, paths: tuple[Path, Path]
) -> TrajectoryPair:
    """Match by time: each pose of the estimate to the ground truth's nearest, and no two to the same.

    A ground truth with about the camera's rate lists the camera's frames. One of a higher rate (motion capture) says
    nothing of them: frames are then the estimate's, with its gaps filled at its own rhythm.
    """
    nearest, difference = _nearest(truth.timestamps, estimate.timestamps)
    of_estimate = np.flatnonzero(difference <= tolerance_s)
    # Of several poses near the same one of the ground truth, the nearest in time gets it.
    order = of_estimate[np.lexsort((difference[of_estimate], nearest[of_estimate]))]
    of_truth, chosen = np.unique(nearest[order], return_index=True)
    of_estimate = order[chosen]
    if len(of_truth) < MINIMUM_FRAMES:
        raise BenchError(_no_match(estimate, truth, tolerance_s, paths, len(of_truth)))
    times = estimate.timestamps[of_estimate]
    step = float(np.median(np.diff(times)))
    if np.median(np.diff(truth.timestamps)) < _DENSER * step:
        numbers = np.concatenate([[0], np.cumsum(np.maximum(np.rint(np.diff(times) / step), 1))])
        outside = int((times[0] - truth.timestamps[0]) / step) + int((truth.timestamps[-1] - times[-1]) / step)
        frame_times = np.interp(np.arange(numbers[-1] + 1), numbers, times)
        sequence, apart = _nearest(truth.timestamps, frame_times)
        known = np.flatnonzero(apart <= tolerance_s)
        truth = Trajectory(truth.T_world_cam[sequence[known]], known, truth.timestamps[sequence[known]])
        numbers = numbers.astype(np.int64)
    else:
        span = np.arange(of_truth[0], of_truth[-1] + 1)
        outside = len(truth) - len(span)
        truth = Trajectory(truth.T_world_cam[span], span, truth.timestamps[span])
        numbers = of_truth.astype(np.int64)
    return TrajectoryPair(
        estimate=Trajectory(estimate.T_world_cam[of_estimate], numbers, times),
        ground_truth=truth,
        outside=outside,
        without_truth=len(estimate) - len(numbers),
        matched_by=f"nearest time within {tolerance_s:g} s",
    )


def _nearest(times: Float, wanted: Float) -> tuple[npt.NDArray[np.intp], Float]:
    """Place of the nearest of ``times`` (increasing) for each wanted one, and how far it is in seconds."""
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    place = np.where(np.abs(times[after] - wanted) < np.abs(times[before] - wanted), after, before)
    return place, np.abs(times[place] - wanted)


def _no_match(estimate: Trajectory, truth: Trajectory, tolerance_s: float, paths: tuple[Path, Path], found: int) -> str:
    spans = [
        f"{path}: {times[0]:.3f} to {times[-1]:.3f} s"
        for path, times in zip(paths, (estimate.timestamps, truth.timestamps), strict=True)
    ]
    return (
        f"{found} poses are within {tolerance_s:g} s of each other, too few to compare ({'; '.join(spans)}). Use the "
        "same clock in both files, or raise --max-time-difference."
    )
