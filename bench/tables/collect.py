"""One table row a run folder, from what is there; a half-written or damaged folder gives a row that says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.errors import BenchError
from bench.evaluation.frame_states import count_states, describe_stretches
from bench.io.csv_files import read_csv
from bench.runs.config_file import read_config
from bench.runs.folder import FRAME_COLUMNS, FRAMES_FILE, METRICS_FILE, RESOURCES_FILE
from bench.runs.status import read_json, read_status
from bench.runs.system_name import system_name

DEFAULT_FOLDER = Path("results/runs")


@dataclass(frozen=True)
class Column:
    """A column of the table: its key in a row, heading, unit, and number of decimals (None: text or a whole number).

    An ``optional`` one is shown only where a row has a value for it (a CSV file has it always).
    """

    key: str
    title: str
    unit: str = ""
    decimals: int | None = None
    optional: bool = False


COLUMNS = (
    Column("run", "Run"),
    Column("dataset", "Dataset"),
    Column("system", "System"),
    Column("stereo", "Stereo"),
    Column("tracker", "Tracker"),
    Column("status", "Status"),
    Column("frames", "Frames"),
    Column("ate_rmse_m", "ATE", "m", 3),
    Column("rpe_trans_rmse_m", "RPE", "m", 4, optional=True),
    Column("t_rel_percent", "t_rel", "%", 2, optional=True),
    Column("r_rel_deg_per_100m", "r_rel", "deg/100m", 3, optional=True),
    Column("t_rel_short_percent", "t_rel 10-50 m", "%", 2, optional=True),
    Column("r_rel_short_deg_per_100m", "r_rel 10-50 m", "deg/100m", 3, optional=True),
    Column("psnr_db", "PSNR", "dB", 2),
    Column("ssim", "SSIM", "", 3),
    Column("lpips", "LPIPS", "", 3),
    Column("depth_l1_cm", "Depth-L1", "cm", 1),
    Column("heldout_psnr_db", "Held-out PSNR", "dB", 2),
    Column("right_psnr_db", "Right PSNR", "dB", 2),
    Column("gaussians", "Gaussians"),
    Column("peak_memory_gb", "Memory", "GB", 2),
    Column("s_per_frame", "Time", "s/frame", 2),
)


TRAJECTORY_KEYS = tuple(column.key for column in COLUMNS if column.optional or column.key == "ate_rmse_m")
"""The columns whose values are those of ``metrics.json``'s ``trajectory``, under the same keys."""


@dataclass(frozen=True)
class Row:
    """Values by column key (None: not known), the protocol stamp of the numbers, and why values are missing.

    ``static_camera``: how many frames have ground truth, and the ATE in metres of a camera that never moves in them.
    A reference row is no run: it is a mark to compare runs with.
    """

    values: dict[str, Any]
    protocol: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    static_camera: tuple[int, float] | None = None
    is_reference: bool = False


def find_runs(paths: list[Path]) -> list[Path]:
    """The run folders among and directly under ``paths``, sorted; under ``results/runs`` when none are given.

    Raises ``BenchError`` for a path that is neither a run folder nor a folder that holds some.
    """
    found: list[Path] = []
    for path in paths or [DEFAULT_FOLDER]:
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
    values: dict[str, Any] = {column.key: None for column in COLUMNS}
    values["run"] = folder.resolve().name
    notes: list[str] = []
    metrics: dict[str, Any] = {}
    for part in (_from_status, _from_config, _from_resources):
        try:
            values |= part(folder)
        except BenchError as error:
            notes.append(str(error))
    frames: dict[str, Any] = {}
    try:
        metrics = read_json(folder / METRICS_FILE) if (folder / METRICS_FILE).is_file() else {}
        frames = _part(metrics, "frames") or _count_frames(folder)
    except BenchError as error:
        notes.append(str(error))
    reason = values.pop("reason", "")
    return row_from_parts(values, metrics, frames, reason, notes)


def row_from_parts(
    values: dict[str, Any], metrics: dict[str, Any], frames: dict[str, Any], reason: str, damaged: Sequence[str] = ()
) -> Row:
    """A row from ``values`` by column key, to which those in ``metrics.json`` are added.

    ``frames`` counts tracking states; ``reason`` is why the run stopped, ``damaged`` what of it can't be read.
    """
    values |= _from_metrics(metrics)
    _show_tracked(frames, values)
    if damaged:
        values["status"] = f"{values['status'] or ''} (damaged)".strip()
    # The run's own words on why it stopped, and on what it could not compute.
    notes = [*damaged, *([f"stopped: {reason}"] if reason else [])]
    notes += about_lost_frames(frames, _part(metrics, "trajectory"))
    notes += [f"{name}: {note}" for name, note in _part(metrics, "notes").items()]
    return Row(values, _part(metrics, "protocol"), tuple(notes), static_camera_of(_part(metrics, "trajectory"), frames))


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
    text = f"{lost} frames lost" + (f" ({describe_stretches(where)})" if isinstance(where, list) else "")
    compared = trajectory.get("static_camera_compared_ate_rmse_m")
    if isinstance(compared, float):
        text += f"; on the others a static camera's ATE is {compared:.3f} m"
    return [text]


def _looks_like_run(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ("config.yaml", "status.json", METRICS_FILE))


def _from_status(folder: Path) -> dict[str, Any]:
    status = read_status(folder)
    if status is None:
        return {"status": "no status"}
    frames = f"{status.frames_done}/{status.frames_total}" if status.frames_total else None
    return {"status": status.describe(), "frames": frames, "reason": status.reason}


def _count_frames(folder: Path) -> dict[str, Any]:
    """Tracking states of a run that was not scored."""
    path = folder / FRAMES_FILE
    if not path.is_file():
        return {}
    table = read_csv(path, FRAME_COLUMNS)
    return {"total": len(table)} | count_states(table["number"].tolist(), table["state"].tolist())


def _show_tracked(frames: dict[str, Any], values: dict[str, Any]) -> None:
    """Put the number of tracked frames, and in the status how many were lost, into a row's values."""
    tracked, lost = frames.get("tracked"), frames.get("lost")
    if not (isinstance(tracked, int) and isinstance(lost, int)):
        return
    total = str(values["frames"] or "").partition("/")[2] or frames.get("total")
    values["frames"] = f"{tracked}/{total}"
    if lost:
        values["status"] = f"{values['status']}, {lost} frames lost"


def _from_config(folder: Path) -> dict[str, Any]:
    known = read_config(folder)
    if known is None:
        return {}
    config, _ = known
    dataset = config.get("dataset")
    name = _name(dataset)
    sequence = dataset.get("sequence") if isinstance(dataset, dict) else None
    return {
        "dataset": f"{name}/{sequence}" if sequence not in (None, "") else name,
        "system": system_name(config),
        "stereo": _name(config.get("stereo")),
        "tracker": _name(config.get("tracker")),
    }


def _from_resources(folder: Path) -> dict[str, Any]:
    """What a run that failed before it was scored has measured."""
    if not (folder / RESOURCES_FILE).is_file():
        return {}
    resources = read_json(folder / RESOURCES_FILE)
    return _resource_values(resources) | {"gaussians": resources.get("gaussians")}


def _from_metrics(metrics: dict[str, Any]) -> dict[str, Any]:
    views = _part(metrics, "views")
    left = _part(views, "left")
    values = {key: left.get(key) for key in ("psnr_db", "ssim", "lpips", "depth_l1_cm")}
    values |= {key: _part(metrics, "trajectory").get(key) for key in TRAJECTORY_KEYS}
    values["heldout_psnr_db"] = _part(views, "heldout").get("psnr_db")
    values["right_psnr_db"] = _part(views, "right").get("psnr_db")
    values["gaussians"] = _part(metrics, "map").get("gaussians")
    values |= _resource_values(_part(metrics, "resources"))
    return {key: value for key, value in values.items() if value is not None}


def _resource_values(resources: dict[str, Any]) -> dict[str, Any]:
    stages = [resources.get(f"{stage}_s_per_frame") for stage in ("tracking", "stereo", "mapping")]
    known = [seconds for seconds in stages if isinstance(seconds, (int, float))]
    return {"peak_memory_gb": resources.get("peak_memory_gb"), "s_per_frame": sum(known) if known else None}


def _part(mapping: dict[str, Any], key: str) -> dict[str, Any]:
    part = mapping.get(key)
    return part if isinstance(part, dict) else {}


def _name(plugin: Any) -> str | None:
    """The name of a part of the config, which is a mapping with a name, or the name itself."""
    name = plugin.get("name") if isinstance(plugin, dict) else plugin
    return str(name) if name not in (None, "") else None
