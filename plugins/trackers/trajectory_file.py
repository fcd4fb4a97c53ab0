"""Tracker that replays a trajectory file, for example one that another SLAM system wrote."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError, require_choice
from bench.geometry.axis_conventions import suspected_convention
from bench.io.torch_files import to_state
from bench.io.trajectories import known_poses, read_kitti_poses, read_tum, read_tum_lines, values_per_line
from bench.registry import PluginConfig, register
from bench.tracking.growing import Growing
from bench.types import Event, Float, StereoFrame, TrackingResult, Trajectory

log = logging.getLogger(__name__)

_FEW = 0.5
"""With poses for less than this share of the frames, a file probably holds keyframes only."""


@dataclass(frozen=True)
class TrajectoryFileConfig(PluginConfig):
    """The file, its format, and which of its poses is whose."""

    path: str = field(default="", metadata={"path": True})
    """The trajectory's file; must be given."""
    format: str = "auto"
    """kitti (12 numbers per line), tum (8) or auto (by their count)."""
    match: str = "auto"
    """Which pose is whose: index (by the order of the lines), time (TUM only) or auto (TUM by time)."""
    max_time_difference_s: float = 0.01
    """How far a TUM pose may be from its frame in time."""

    def __post_init__(self) -> None:
        require_choice("tracker.format", self.format, ("auto", "kitti", "tum"))
        require_choice("tracker.match", self.match, ("auto", "index", "time"))
        if not self.max_time_difference_s > 0:
            raise BenchError(f"tracker.max_time_difference_s={self.max_time_difference_s} must be above 0 seconds.")


@register("tracker", "trajectory_file", config=TrajectoryFileConfig)
class TrajectoryFile(Tracker):
    """Poses from a file in KITTI or TUM format.

    By index, line k is frame number k, so the file of a whole sequence serves any part of it; a file with exactly as
    many lines as the data set has frames is taken by position. By time, it is the nearest pose; frames without one are
    lost.
    """

    def __init__(self, config: TrajectoryFileConfig) -> None:
        if not config.path:
            raise BenchError("tracker=trajectory_file needs tracker.path=FILE, a trajectory in KITTI or TUM format.")
        self._config = config
        self._path = Path(config.path).expanduser()
        self._by_number: dict[int, Float] = {}
        self._by_time: Trajectory | None = None
        self._numbers, self._times = Growing(np.empty(0, np.int64)), Growing(np.empty(0))
        self._poses = Growing(np.empty((0, 4, 4)))
        self._seen = self._expected = 0
        self._in_gap = False
        self._doubts: list[str] = []

    def start(self, dataset: Dataset) -> None:
        """Read the file and check that it covers the data set; raises ``BenchError`` if it does not.

        A trajectory that seems to be in another convention is warned of, not refused: nobody can be sure of it.
        """
        self._by_number, self._by_time = {}, None
        self._numbers, self._times = Growing(np.empty(0, np.int64)), Growing(np.empty(0))
        self._poses = Growing(np.empty((0, 4, 4)))
        self._seen, self._expected, self._in_gap, self._doubts = 0, len(dataset), False, []
        if self._format() == "tum":
            _, poses = read_tum_lines(self._path)
            if self._config.match != "index":
                self._by_time = read_tum(self._path)
                # The contract has no list of times; the two ends are enough to catch a file of another clock at once.
                self._check_times(dataset.frame(0).timestamp, dataset.frame(len(dataset) - 1).timestamp)
        else:
            if self._config.match == "time":
                raise BenchError(
                    f"tracker.match=time: {self._path} is in KITTI's format, which has no times. Use index."
                )
            poses = read_kitti_poses(self._path)
        if self._by_time is None:
            indexed = self._indexed(poses, dataset)
            self._by_number = {number: T for number, T in indexed.items() if np.isfinite(T).all()}
            if len(poses) != len(dataset):
                counts = f"{self._path.name} has {len(poses)} poses for {len(dataset)} frames"
                self._doubts.append(f"{counts}: line k (from 0) is of frame k")
        suspicion = suspected_convention(poses[known_poses(poses)])
        if suspicion is not None:
            self._doubts.append(f"{self._path.name}: {suspicion}. Convert the file if that is so.")

    def track(self, frame: StereoFrame) -> TrackingResult:
        """The pose that belongs to the frame, or "lost"."""
        T = self._pose_of(frame.number, frame.timestamp)
        self._seen += 1
        told = tuple(Event("warning", frame.number, {"text": text}) for text in self._doubts)
        self._doubts = []
        if T is None:
            if self._seen == self._expected and not len(self._poses):
                raise BenchError(self._no_match("no pose is near any frame in time"))
            if not self._in_gap:
                log.warning("frame %d: %s", frame.number, self._gap_at(frame.timestamp))
            self._in_gap = True
            return TrackingResult(None, "lost", events=told)
        self._in_gap = False
        self._keep(frame.number, frame.timestamp, T)
        return TrackingResult(T, "ok", events=told)

    def trajectory(self) -> Trajectory:
        """Poses of the frames tracked so far; those without a pose are absent."""
        return Trajectory(self._poses.rows, self._numbers.rows, self._times.rows)

    def state(self) -> dict[str, Any]:
        """Which frames had a pose so far, and what is still to be told; the poses are in the file."""
        tracked = {"numbers": self._numbers.rows, "times": self._times.rows}
        return {"seen": self._seen, "in_gap": self._in_gap, "doubts": list(self._doubts), **to_state(tracked)}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._seen, self._in_gap, self._doubts = state["seen"], state["in_gap"], list(state["doubts"])
        for number, time in zip(state["numbers"].tolist(), state["times"].tolist(), strict=True):
            T = self._pose_of(number, time)
            if T is None:
                raise BenchError(f"{self._path} has changed since the run began: frame {number} has no pose any more.")
            self._keep(number, time, T)

    def _pose_of(self, number: int, timestamp: float) -> Float | None:
        return self._by_number.get(number) if self._by_time is None else self._nearest(timestamp)

    def _keep(self, number: int, timestamp: float, T: Float) -> None:
        self._numbers.append(number)
        self._times.append(timestamp)
        self._poses.append(T)

    def _format(self) -> str:
        if self._config.format != "auto":
            return self._config.format
        count = values_per_line(self._path)
        formats = {12: "kitti", 8: "tum"}
        if count not in formats:
            raise BenchError(
                f"{self._path} has {count} values in its first line; KITTI has 12 and TUM 8. Set tracker.format to see "
                "which line is wrong, or convert the file."
            )
        return formats[count]

    def _indexed(self, poses: Float, dataset: Dataset) -> dict[int, Float]:
        if len(poses) == len(dataset):
            return dict(zip(dataset.numbers, poses, strict=True))
        if dataset.numbers[-1] < len(poses):
            return {number: poses[number] for number in dataset.numbers}
        raise BenchError(
            f"{self._path} has {len(poses)} poses, but {dataset.label} has {len(dataset)} frames numbered up to "
            f"{dataset.numbers[-1]}. It needs one line per frame, or one for every number from 0."
        )

    def _check_times(self, first: float, last: float) -> None:
        """Raise ``BenchError`` for times of another clock or frame numbers in their place; warn of too few."""
        assert self._by_time is not None
        times, slack = self._by_time.timestamps, self._config.max_time_difference_s
        begin, end = times[[0, -1]]
        if begin > last + slack or end < first - slack:
            raise BenchError(
                self._no_match(f"its times {begin:.3f} to {end:.3f} s miss the frames' {first:.3f} to {last:.3f} s")
            )
        counts = np.array_equal(times, np.round(times)) and (np.diff(times) == 1).all()
        if counts and end > last + 1 and last - first < self._expected - 1:
            raise BenchError(
                f"{self._path}: its times {begin:.0f}, {begin + 1:.0f}, ... are frame numbers, not seconds. Use "
                "tracker.match=index, or write times."
            )
        within = int(((times > first - slack) & (times < last + slack)).sum())
        if within < _FEW * self._expected:
            self._doubts.append(
                f"{self._path.name} has {within} poses for {self._expected} frames, so most frames are lost; a file of "
                "keyframes only?"
            )

    def _gap_at(self, timestamp: float) -> str:
        """What to say of a frame that has no pose: between which poses it lies."""
        if self._by_time is None:
            return f"{self._path} has no pose of it: its line is NaN"
        times = self._by_time.timestamps
        after = int(np.searchsorted(times, timestamp))
        if after == 0:
            where = f"begins only at {times[0]:.3f} s"
        elif after == len(times):
            where = f"ends at {times[-1]:.3f} s already"
        else:
            where = f"has a gap from {times[after - 1]:.3f} to {times[after]:.3f} s"
        return f"{self._path} {where}; no pose within {self._config.max_time_difference_s} s of {timestamp:.3f} s"

    def _no_match(self, what: str) -> str:
        return (
            f"{self._path}: {what} (tolerance {self._config.max_time_difference_s} s). Use the data set's clock in the "
            "file, or raise tracker.max_time_difference_s."
        )

    def _nearest(self, timestamp: float) -> Float | None:
        assert self._by_time is not None
        times = self._by_time.timestamps
        after = int(np.searchsorted(times, timestamp))
        near = min((i for i in (after - 1, after) if 0 <= i < len(times)), key=lambda i: abs(times[i] - timestamp))
        close = abs(times[near] - timestamp) <= self._config.max_time_difference_s
        return self._by_time.T_world_cam[near] if close else None
