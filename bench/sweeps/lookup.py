"""What a planned run's folder says of it: whether there is a run, and how it ended."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from bench.errors import BenchError
from bench.runs.config_file import CONFIG_FILE
from bench.runs.folder import METRICS_FILE
from bench.runs.status import read_status

Progress = Literal["missing", "finished", "failed", "interrupted", "elsewhere", "out of sight"]
"""``finished``: done and scored. ``interrupted``: stopped, killed or not scored. ``elsewhere``: another process of this
machine makes it. ``out of sight``: it says so of a process on another machine."""

# A run tells how far it is about once a second, but for long steps: one of another machine that has been silent for so
# long is dead.
SILENT_S = 1800.0


@dataclass(frozen=True)
class Found:
    """State of a run folder; ``reason`` says more, or is empty."""

    progress: Progress
    reason: str = ""


def look_up(folder: Path) -> Found:
    """Read the state of a run folder; one with a damaged ``status.json`` counts as failed, with that as the reason."""
    if not (folder / CONFIG_FILE).is_file():
        return Found("missing")
    try:
        status = read_status(folder)
    except BenchError as error:
        return Found("failed", str(error))
    if status is None:
        return Found("interrupted", "it has not begun")
    if status.is_complete:
        scored = (folder / METRICS_FILE).is_file()
        return Found("finished") if scored else Found("interrupted", status.reason or "it was not scored")
    if status.state in ("failed", "out_of_memory"):
        words = [status.describe()] if status.state == "out_of_memory" else []
        return Found("failed", ": ".join([*words, *([status.reason] if status.reason else [])]))
    if status.state == "running" and status.host != socket.gethostname():
        where = f"running on {status.host}, process {status.pid}"
        silent_s = _seconds_since(status.updated)
        if silent_s is not None and silent_s > SILENT_S:
            return Found("interrupted", f"{where}, but silent for {silent_s / 60:.0f} min")
        return Found("out of sight", f"{where}; delete the folder if that is no longer so")
    if status.is_alive():
        return Found("elsewhere", f"process {status.pid}")
    return Found("interrupted", status.reason or status.describe())


def _seconds_since(moment: str) -> float | None:
    """Since a time in ISO 8601; None where it is none."""
    try:
        then = datetime.fromisoformat(moment)
    except ValueError:
        return None
    return (datetime.now(UTC) - then).total_seconds() if then.tzinfo is not None else None
