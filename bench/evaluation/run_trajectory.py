"""The trajectory of a saved run beside its ground truth, or why there is none to compare."""

from __future__ import annotations

from bench.contracts.saved_run import SavedRun
from bench.runs.folder import TRAJECTORY_FILE
from bench.runs.system_name import external_name
from bench.types import Trajectory


def estimate_and_truth(run: SavedRun) -> tuple[Trajectory, Trajectory] | str:
    """The run's estimate and its ground truth, as they were saved, or the reason why one is missing."""
    if not run.status.is_complete and not (run.path / TRAJECTORY_FILE).is_file():
        return "the run stopped before it saved its trajectory"
    if external_name(run.config) is not None and not (run.path / TRAJECTORY_FILE).is_file():
        return "the system's output has no trajectory"
    if run.ground_truth is None:
        return "the data set gives no ground-truth poses"
    return run.trajectory, run.ground_truth
