"""What a planned run's folder says of it: whether there is a run, and how it ended."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bench.errors import BenchError
from bench.runs.config_file import CONFIG_FILE
from bench.runs.folder import METRICS_FILE
from bench.runs.status import read_status

Progress = Literal["missing", "finished", "failed", "interrupted", "elsewhere", "out of sight"]
"""``finished``: done and scored. ``interrupted``: stopped, killed or not scored. ``elsewhere``: another process of this
machine makes it. ``out of sight``: it says so of a process on another machine."""


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
    if status.state == "done":
        scored = (folder / METRICS_FILE).is_file()
        return Found("finished") if scored else Found("interrupted", "it was not scored")
    if status.state in ("failed", "out_of_memory"):
        words = [status.describe()] if status.state == "out_of_memory" else []
        return Found("failed", ": ".join([*words, *([status.reason] if status.reason else [])]))
    if status.state == "running" and status.host != socket.gethostname():
        gone = "delete the folder if that is no longer so"
        return Found("out of sight", f"running on {status.host}, process {status.pid}; {gone}")
    if status.is_alive():
        return Found("elsewhere", f"process {status.pid}")
    return Found("interrupted", status.reason or status.describe())
