"""One table row per run folder, from what is there; a half-written or damaged folder gives a row that says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.contracts.metric import Metric
from bench.errors import BenchError
from bench.evaluation.frame_states import describe_stretches
from bench.evaluation.metrics import declared_metrics
from bench.runs.config_file import RUNS_FOLDER
from bench.runs.folder import METRICS_FILE
from bench.tables.records.folder import read_run
from bench.tables.records.record import RunRecord


@dataclass(frozen=True)
class Column:
    """A column of the table: its key in a row, heading, unit, and number of decimals.

    Without decimals it is text, or with ``is_number`` a whole number. An ``optional`` one is shown only where a
    row has a value for it (a CSV file has it always).
    """

    key: str
    title: str
    unit: str = ""
    decimals: int | None = None
    optional: bool = False
    is_number: bool = False


FIXED = (
    Column("run", "Run"),
    Column("dataset", "Dataset"),
    Column("system", "System"),
    Column("stereo", "Stereo"),
    Column("tracker", "Tracker"),
    Column("status", "Status"),
    Column("frames", "Frames"),
    Column("weak", "Weak", is_number=True),
    Column("predicted", "Predicted", optional=True, is_number=True),
    Column("lost", "Lost", is_number=True),
)
"""What every run has, before its metrics."""


@dataclass(frozen=True)
class Row:
    """Values by column key (None: not known), the protocol stamp of the numbers, and why values are missing.

    ``static_camera``: how many frames have ground truth, and the ATE in metres of a camera that never moves in them.
    A reference row is no run: it is a mark to compare runs with. ``own_metrics`` are those that no evaluator of the
    project declares. ``runs`` are those that the row is of, more than one where it is of means over seeds.
    """

    values: dict[str, Any]
    protocol: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    static_camera: tuple[int, float] | None = None
    is_reference: bool = False
    own_metrics: tuple[Metric, ...] = ()
    runs: tuple[RunRecord, ...] = ()


def find_runs(paths: list[Path]) -> list[Path]:
    """The run folders among and directly under ``paths``, sorted; under ``results/runs`` when none are given.

    Raises ``BenchError`` for a path that is neither a run folder nor a folder that holds some.
    """
    found: list[Path] = []
    for path in paths or [RUNS_FOLDER]:
        if not path.is_dir():
            raise BenchError(f"There is no folder {path}. Give run folders, or make a run first with `bgs-bench run`.")
        runs = (
            [path] if _looks_like_run(path) else sorted(folder for folder in path.iterdir() if _looks_like_run(folder))
        )
        if not runs:
            raise BenchError(f"{path} is no run folder and holds none. Give folders that `bgs-bench run` wrote.")
        found += [run for run in runs if run not in found]
    return found


def collect_row(folder: Path) -> Row:
    """The row of one run folder; never raises for what the folder holds."""
    return row_of(read_run(folder))


def row_of(run: RunRecord) -> Row:
    """The row of a run, from its folder or a record file; of a run that was never scored a record lacks resources."""
    values: dict[str, Any] = {
        "run": run.name,
        "dataset": run.dataset,
        "system": run.system,
        "stereo": run.plugin("stereo"),
        "tracker": run.plugin("tracker"),
        "status": run.state,
        "frames": f"{run.frames_done}/{run.frames_total}" if run.frames_total else None,
    }
    for metric in (*declared_metrics(), *run.own_metrics):
        value = metric.value_in(run.metrics)
        values[metric.key] = metric.value_in(run.measured) if value is None else value
    frames, trajectory = run.part("frames") or dict(run.measured.get("frames", {})), run.part("trajectory")
    _show_tracked(frames, values)
    if run.damage:
        values["status"] = f"{values['status']} (damaged)".strip()
    # The run's own words on why it stopped, and on what it could not compute.
    notes = [*run.damage, *([f"stopped: {run.reason}"] if run.reason else [])]
    notes += [*about_lost_frames(frames, trajectory), *run.notes]
    static_camera = static_camera_of(trajectory, frames)
    return Row(values, dict(run.protocol), tuple(notes), static_camera, own_metrics=run.own_metrics, runs=(run,))


def columns_of(rows: Sequence[Row]) -> tuple[Column, ...]:
    """The columns of a table of runs: what every run has, and all metrics that evaluators declare."""
    metrics = {metric.key: metric for row in rows for metric in row.own_metrics}
    metrics |= {metric.key: metric for metric in declared_metrics()}
    shown = sorted((metric for metric in metrics.values() if metric.column != "never"), key=lambda each: each.order)
    return FIXED + tuple(
        Column(each.key, each.title, each.unit, each.decimals, each.column == "known", is_number=True) for each in shown
    )


def static_camera_of(trajectory: dict[str, Any], frames: dict[str, Any]) -> tuple[int, float] | None:
    """Frames and error of a static camera, from ``trajectory`` and ``frames`` of ``metrics.json``, or None."""
    error, known = trajectory.get("static_camera_ate_rmse_m"), [frames.get("tracked"), frames.get("lost")]
    counts = [count for count in known if isinstance(count, int)]
    return (sum(counts), error) if isinstance(error, float) and len(counts) == len(known) else None


def about_lost_frames(frames: dict[str, Any], trajectory: dict[str, Any]) -> list[str]:
    """Which frames were lost, as a footnote, with what a static camera gets on the others; nothing if none were."""
    lost = frames.get("lost")
    if not isinstance(lost, int) or lost == 0:
        return []
    where = frames.get("lost_stretches")
    stretches = [each for each in where if isinstance(each, list) and len(each) == 2] if isinstance(where, list) else []
    text = f"{lost} frames lost" + (f" ({describe_stretches(stretches)})" if stretches else "")
    compared = trajectory.get("static_camera_compared_ate_rmse_m")
    if isinstance(compared, float):
        text += f"; on the others a static camera's ATE is {compared:.3f} m"
    return [text]


def _looks_like_run(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ("config.yaml", "status.json", METRICS_FILE))


def _show_tracked(frames: dict[str, Any], values: dict[str, Any]) -> None:
    """Put the numbers of tracked, weak, predicted and lost frames into a row's values, those lost in the status too."""
    tracked, lost = frames.get("tracked"), frames.get("lost")
    if not (isinstance(tracked, int) and isinstance(lost, int)):
        return
    total = str(values["frames"] or "").partition("/")[2] or frames.get("total")
    values |= {"frames": f"{tracked}/{total}", "lost": lost} | {
        state: frames.get(state) for state in ("weak", "predicted")
    }
    if lost:
        values["status"] = f"{values['status']}, {lost} frames lost"
