"""One run as the report shows it: what can be read of its folder, and in words what can't."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd

from bench.contracts.saved_run import SavedRun
from bench.errors import BenchError
from bench.evaluation.run_trajectory import estimate_and_truth
from bench.evaluation.saved_run import SavedRunFolder
from bench.evaluation.trajectory import AteResult, absolute_trajectory_error
from bench.io.csv_files import read_csv
from bench.runs.events import read_events
from bench.runs.folder import METRICS_FILE, PER_FRAME_FILE, View
from bench.tables.collect import Row, row_of
from bench.tables.records.folder import read_provenance, read_run
from bench.tables.records.record import RunRecord
from bench.types import Trajectory

T = TypeVar("T")
# Columns that are no numbers.
_WORDS = ("view", "state", "keyframe_reason", "is_keyframe", "tracking_cached", "stereo_cached")
# A trajectory that was not changed since it was scored gives the same ATE but for the last digits.
_SAME_ATE_M = 1e-6


@dataclass(frozen=True)
class Path2D:
    """A run's way as it was scored: the estimate aligned for the ATE, and its ground truth; or the estimate alone."""

    estimate: Trajectory
    truth: Trajectory | None = None
    ate: AteResult | None = None


@dataclass(frozen=True)
class ShownRun:
    """What the pages are made from. ``problems`` are sentences on what is missing, damaged or not finished.

    ``frames`` has a row per frame that was processed, ``views`` one per scored view (columns view, number and the
    evaluators' values); both are empty tables where the run has none. ``loops`` are pairs of frame numbers.
    """

    record: RunRecord
    row: Row
    saved: SavedRun | None
    frames: pd.DataFrame
    views: pd.DataFrame
    path: Path2D | None
    loops: tuple[tuple[int, int], ...]
    provenance: dict[str, object]
    problems: tuple[str, ...]

    @property
    def is_whole(self) -> bool:
        """Whether the run is done and scored, and nothing of it is damaged: its numbers can stand beside others."""
        return self.record.state == "done" and self.record.is_scored and not self.record.damage


def read_shown_run(folder: Path) -> ShownRun:
    """Read a run folder; never raises for what the folder holds."""
    record = read_run(folder)
    problems = _about_state(record)
    saved = _tried(lambda: SavedRunFolder(folder), None, problems)
    frames, views, path = pd.DataFrame(), pd.DataFrame(columns=["view", "number"]), None
    loops: tuple[tuple[int, int], ...] = ()
    provenance: dict[str, object] = {}
    if saved is not None:
        frames = _tried(lambda: _numeric(saved.frames), frames, problems)
        if (folder / PER_FRAME_FILE).is_file():
            views = _tried(lambda: _scored_views(folder / PER_FRAME_FILE), views, problems)
        elif record.is_scored:
            problems.append(f"{folder / PER_FRAME_FILE} is missing, so there are no curves and no worst frames of it")
        path = _tried(lambda: _path(saved, record, problems), None, problems)
        loops = _tried(lambda: _loops(folder), loops, problems)
        provenance = _tried(lambda: read_provenance(folder), provenance, problems)
    problems += [each for each in record.damage if each not in problems]
    return ShownRun(record, row_of(record), saved, frames, views, path, loops, provenance, tuple(problems))


def seen_by_mapping(run: ShownRun, camera: View, number: int) -> tuple[str, bool]:
    """In words whether mapping learned from this view, and whether it is known that it did not."""
    of_frame = run.frames[run.frames["number"] == number]
    if not len(of_frame):
        return "not known whether mapping saw it", False
    frame = of_frame.iloc[0]
    if camera == "right":
        if run.record.protocol.get("right_images_mapped", False) is None:
            return "right camera, not known whether mapping saw it", False
        mapped = "right_mapped" in frame and bool(frame["right_mapped"])
        return ("right camera, mapped", False) if mapped else ("right camera, unseen by mapping", True)
    if frame["mapped"]:
        return "mapped", False
    return ("held out, unseen by mapping", True) if frame["heldout"] else ("not mapped", True)


def _about_state(record: RunRecord) -> list[str]:
    """What a reader must know before any number: that the run is not done, or was not scored."""
    said = []
    if record.state not in ("done", ""):
        reason = f": {record.reason}" if record.reason else ""
        of = f" after {record.frames_done} of {record.frames_total} frames" if record.frames_total else ""
        said.append(f"This run is not done ({record.state}{of}){reason}. The same command resumes it.")
    if not (record.source / METRICS_FILE).is_file():
        said.append(f"This run was not scored; `bgs-bench evaluate {record.source}` does that.")
    return said


def _tried(read: Callable[[], T], otherwise: T, problems: list[str]) -> T:
    try:
        return read()
    except BenchError as error:
        problems.append(str(error))
        return otherwise


def _scored_views(path: Path) -> pd.DataFrame:
    table = _numeric(read_csv(path, ["view", "number"])).dropna(subset=["number"])
    return table.astype({"number": np.int64}).drop_duplicates(["view", "number"])


def _numeric(table: pd.DataFrame) -> pd.DataFrame:
    """The table with what is no number, but for words and yes or no, as NaN."""
    numbers = [name for name in table if table[name].dtype != bool and name not in _WORDS]
    return table.assign(**{name: pd.to_numeric(table[name], errors="coerce") for name in numbers})


def _path(saved: SavedRun, record: RunRecord, problems: list[str]) -> Path2D | None:
    found = estimate_and_truth(saved)
    if isinstance(found, str):
        problems.append(f"The trajectory has no errors: {found}.")
        there = (saved.path / "trajectory.csv").is_file()
        return Path2D(saved.trajectory) if there and len(saved.trajectory) else None
    estimate, truth = found
    ate = absolute_trajectory_error(estimate, truth, saved.protocol.alignment)
    if isinstance(ate, str):
        problems.append(f"The trajectory has no errors: {ate}.")
        return Path2D(estimate, truth)
    scored = record.values.get("ate_rmse_m")
    if scored is not None and abs(scored - ate.rmse_m) > _SAME_ATE_M * max(1.0, scored):
        problems.append(
            f"The trajectory files give an ATE of {ate.rmse_m:.3f} m and the scores say {scored:.3f} m: one of them "
            f"was changed, so no trajectory is drawn; `bgs-bench evaluate {saved.path}` scores it again."
        )
        return None
    return Path2D(ate.aligned, truth, ate)


def _loops(folder: Path) -> tuple[tuple[int, int], ...]:
    closed = [event for event in read_events(folder) if event.kind == "loop_closed"]
    pairs = [(event.frame, event.values.get("to_frame")) for event in closed]
    return tuple((frame, to) for frame, to in pairs if isinstance(to, int))


def values_of(run: ShownRun, camera: View, column: str, numbers: Sequence[int] | None = None) -> pd.Series:
    """One of the evaluators' values by frame number, of the views of ``camera``; of ``numbers`` alone if given."""
    if column not in run.views:
        return pd.Series(dtype=np.float64)
    of_camera = run.views[run.views["view"] == camera].set_index("number")[column].dropna()
    return of_camera if numbers is None else of_camera[of_camera.index.isin(numbers)]
