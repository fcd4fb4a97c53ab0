"""A run as the process that starts it gets it: small, picklable, and without the project's heavy imports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.sweeps.lookup import Found


@dataclass(frozen=True)
class Job:
    """``arguments`` are what Python is given, in the folder ``cwd``; ``folder`` (absolute) is the run folder."""

    label: str
    folder: Path
    cwd: Path
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """How a run ended and after how many seconds; ``found`` is what its folder says now, or what went wrong before.

    ``place`` says which machine of a cluster made it, or is empty.
    """

    job: Job
    found: Found
    seconds: float
    place: str = ""
