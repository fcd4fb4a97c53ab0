"""Trajectories of a run folder as CSV: with frame numbers, so that lost frames stay visible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bench.errors import BenchError
from bench.io.csv_files import read_csv
from bench.io.foreign import reading
from bench.types import Trajectory

_POSE_COLUMNS = [f"T_{row}{column}" for row in range(3) for column in range(4)]


def as_csv(trajectory: Trajectory) -> str:
    """One line per frame: number, timestamp in seconds, the 3x4 ``T_world_cam`` row by row; all digits of float64."""
    table = pd.DataFrame(trajectory.T_world_cam[:, :3].reshape(-1, 12), columns=_POSE_COLUMNS)
    table.insert(0, "timestamp", trajectory.timestamps)
    table.insert(0, "number", trajectory.numbers)
    return str(table.to_csv(index=False))


def read_trajectory_csv(path: Path) -> Trajectory:
    """Read what ``as_csv`` made; raises ``BenchError`` for a missing or damaged file."""
    table = read_csv(path, ["number", "timestamp", *_POSE_COLUMNS])
    with reading(path, "can't be read as numbers", "Run again with rerun=true."):
        numbers = table["number"].to_numpy(dtype=np.int64)
        timestamps = table["timestamp"].to_numpy(dtype=np.float64)
        rows = table[_POSE_COLUMNS].to_numpy(dtype=np.float64)
    if not (np.isfinite(timestamps).all() and np.isfinite(rows).all()):
        raise BenchError(f"{path} holds a number that is not finite; run again with rerun=true.")
    if len(np.unique(numbers)) != len(numbers):
        raise BenchError(f"{path} has more than one pose for the same frame; run again with rerun=true.")
    T_world_cam = np.tile(np.eye(4), (len(table), 1, 1))
    T_world_cam[:, :3] = rows.reshape(-1, 3, 4)
    return Trajectory(T_world_cam, numbers, timestamps)
