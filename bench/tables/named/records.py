"""What a named table needs of a run folder, read fast: a thousand folders in about a second."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from yaml import YAMLError  # type: ignore[import-untyped]  # comes with omegaconf

from bench.errors import BenchError
from bench.runs.config_file import CONFIG_FILE
from bench.runs.config_text import parse_config
from bench.runs.folder import METRICS_FILE
from bench.runs.status import read_json, read_status
from bench.tables.collect import DEFAULT_FOLDER, find_runs

VIEW_GROUPS = ("left", "heldout", "right")


@dataclass(frozen=True)
class RunRecord:
    """One run. ``values`` by metric key (only those that are known); ``frames`` is how many the run got through.

    ``state`` is that of ``status.json`` in words ("done", "out of memory", "killed" ...). ``config`` is shared between
    records and must not be changed.
    """

    folder: Path
    config: Mapping[str, Any]
    state: str
    reason: str = ""
    frames: int = 0
    values: Mapping[str, float] = field(default_factory=dict)
    protocol: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    static_camera_m: float | None = None

    @property
    def seed(self) -> int:
        """The run's seed; 0 where its config has none."""
        seed = self.config.get("seed")
        return seed if isinstance(seed, int) else 0


def read_records(paths: list[Path], views: str = "left") -> tuple[list[RunRecord], list[str]]:
    """The runs in and directly under ``paths`` (default ``results/runs``), by path, and what is wrong with others.

    ``views`` says whose PSNR, SSIM, LPIPS and Depth-L1 are read: "left" (all left images), "heldout" or "right".
    Raises ``BenchError`` for a path that was given and holds no run; no runs in the default folder are no error.
    """
    if not paths and not any(DEFAULT_FOLDER.glob(f"*/{CONFIG_FILE}")):
        return [], []
    records, problems = [], []
    for folder in sorted(set(find_runs(paths))):
        try:
            records.append(read_record(folder, views))
        except BenchError as error:
            problems.append(str(error))
    return records, problems


def read_record(folder: Path, views: str = "left") -> RunRecord:
    """One run folder; raises ``BenchError`` when a file that is there is damaged, or there is no config."""
    config = _read_config(folder / CONFIG_FILE)
    status = read_status(folder)
    metrics = read_json(folder / METRICS_FILE) if (folder / METRICS_FILE).is_file() else {}
    state = "no status" if status is None else status.describe()
    total = _part(metrics, "frames").get("total")
    # An interrupted run's metrics name the frames that there were to do.
    frames = status.frames_done if status is not None and (status.frames_done or state != "done") else 0
    if state in ("done", "no status") and isinstance(total, int):
        frames = total
    trajectory = _part(metrics, "trajectory")
    static = trajectory.get("static_camera_ate_rmse_m")
    return RunRecord(
        folder,
        config,
        state,
        status.reason if status is not None else "",
        frames,
        _values(metrics, views),
        _part(metrics, "protocol"),
        tuple(f"{name}: {reason}" for name, reason in _part(metrics, "notes").items()),
        static if _is_number(static) else None,
    )


def _values(metrics: dict[str, Any], views: str) -> dict[str, float]:
    image = _part(_part(metrics, "views"), views)
    found: dict[str, Any] = {key: image.get(key) for key in ("psnr_db", "ssim", "lpips", "depth_l1_cm")}
    found |= _part(metrics, "resources")
    found["ate_rmse_m"] = _part(metrics, "trajectory").get("ate_rmse_m")
    return {key: value for key, value in found.items() if _is_number(value)}


def _read_config(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"Can't read {path}: {error}. Delete the run folder and run again.") from error
    try:
        config = parse_config(text)
    except YAMLError as error:
        raise BenchError(
            f"{path} can't be read: {' '.join(str(error).split())}. Delete the run folder and run again."
        ) from error
    if not config:
        raise BenchError(f"{path} holds no settings. Delete the run folder and run again.")
    return config


def _part(mapping: Mapping[str, Any], key: str) -> dict[str, Any]:
    part = mapping.get(key)
    return part if isinstance(part, dict) else {}


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
