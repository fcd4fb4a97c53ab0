"""Reading run folders as tables see them, fast: a thousand in about a second."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from bench.errors import BenchError
from bench.evaluation.frame_states import count_states
from bench.io.csv_files import read_csv
from bench.runs.config_file import CONFIG_FILE, read_shared_config
from bench.runs.events import read_events
from bench.runs.folder import (
    FRAME_COLUMNS,
    FRAMES_FILE,
    METRICS_FILE,
    PROVENANCE_FILE,
    RESOURCES_FILE,
    map_size,
    require_own_files,
)
from bench.runs.status import read_json, read_status
from bench.tables.records.portable import portable, portable_config, portable_text
from bench.tables.records.record import RunRecord, what_no_run_writes

T = TypeVar("T")


def read_run(folder: Path) -> RunRecord:
    """A run folder as it is, with what an unscored run measured; what can't be read is left out and in ``damage``."""
    try:
        require_own_files(folder)
    except BenchError as error:
        return RunRecord(folder.resolve().name, folder, config={}, state="", damage=(str(error),))
    run = _read(folder)
    damage = list(run.damage)
    resources: dict[str, Any] = _tried(lambda: _if_there(folder / RESOURCES_FILE), {}, damage)
    frames: dict[str, Any] = _tried(lambda: _count_frames(run), {}, damage)
    measured = {
        "resources": resources,
        "map": map_size(resources),
        "frames": frames,
    }
    return replace(run, measured=measured, damage=tuple(damage))


def read_folder(folder: Path, views: str = "left") -> RunRecord:
    """A run folder as it may be kept: with its provenance, and without anything about where it lay.

    Raises ``BenchError`` when a file that is there is damaged, or there is no config.
    """
    require_own_files(folder)
    run = _read(folder)
    if run.damage:
        raise BenchError(run.damage[0])
    if not run.config:
        raise BenchError(f"{folder / CONFIG_FILE} holds no settings of a run. Delete the run folder and run again.")
    return replace(
        run,
        config=portable_config(run.config),
        reason=portable_text(run.reason),
        metrics=portable(run.metrics),
        protocol=portable(run.protocol),
        provenance=read_provenance(folder),
        views=views,
    )


def read_provenance(folder: Path) -> dict[str, Any]:
    """What a run folder knows of how it was made: commit, versions, machine, weights, and the loops that were closed.

    Without names of users or folders. Empty where nothing was written; ``BenchError`` for a damaged file.
    """
    written = _if_there(folder / PROVENANCE_FILE)
    found: dict[str, Any] = {key: written[key] for key in ("git", "packages", "python", "weights") if key in written}
    machine = written.get("machine")
    if isinstance(machine, Mapping):
        found["machine"] = {key: machine[key] for key in ("cpu", "usable_cores", "gpu", "mm_ms") if key in machine}
    closed = [event for event in read_events(folder) if event.kind == "loop_closed"]
    loops = [[event.frame, event.values.get("to_frame")] for event in closed]
    if loops:
        found["loops_closed"] = loops
    return {key: portable(value) for key, value in found.items()}


def _read(folder: Path) -> RunRecord:
    damage: list[str] = []
    status = _tried(lambda: read_status(folder), None, damage)
    state = status.describe() if status is not None else "" if damage else "no status"
    config = _tried(lambda: read_shared_config(folder), None, damage)
    metrics: dict[str, Any] = _tried(lambda: _if_there(folder / METRICS_FILE), {}, damage)
    stamp = metrics.pop("protocol", {})
    run = RunRecord(
        name=folder.resolve().name,
        source=folder,
        config=config[0] if config is not None else {},
        state=state,
        reason=status.reason if status is not None else "",
        frames_done=status.frames_done if status is not None else 0,
        frames_total=status.frames_total if status is not None else 0,
        date=status.updated.partition("T")[0] if status is not None else "",
        metrics=metrics,
        protocol=stamp if isinstance(stamp, dict) else {},
        damage=tuple(damage),
    )
    wrong = what_no_run_writes(run)
    if not wrong:
        return run
    return replace(run, config={}, metrics={}, protocol={}, damage=(*damage, f"{folder}: {wrong}; run again."))


def _tried(read: Callable[[], T], otherwise: T, damage: list[str]) -> T:
    try:
        return read()
    except BenchError as error:
        damage.append(str(error))
        return otherwise


def _count_frames(run: RunRecord) -> dict[str, Any]:
    """Tracking states of a run that was not scored."""
    path = run.source / FRAMES_FILE
    if run.part("frames") or run.damage or not path.is_file():
        return {}
    table = read_csv(path, FRAME_COLUMNS)
    return {"total": len(table)} | count_states(table["number"].tolist(), table["state"].tolist())


def _if_there(path: Path) -> dict[str, Any]:
    return read_json(path) if path.is_file() else {}
