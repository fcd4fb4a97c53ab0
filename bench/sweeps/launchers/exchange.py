"""What a sweep and its workers tell each other, through a folder that all of them see: begun, waiting, ended, stop."""

from __future__ import annotations

import os
import secrets
import shutil
import socket
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.errors import BenchError
from bench.io.atomic import write_json
from bench.runs.status import read_json
from bench.sweeps.claim import SWEEP_FOLDER
from bench.sweeps.job import Job, Outcome
from bench.sweeps.lookup import Found

_STOP, _NO_MORE = "stop", "begin-no-more"


@dataclass(frozen=True)
class Note:
    """The last word of the worker of a run: ``state`` is "begun" (it has a slot), "running", "waiting" or "ended".

    ``who`` is whom it waits for; ``found`` and ``seconds`` are those of its outcome.
    """

    state: str
    place: str = ""
    who: str = ""
    found: Found = field(default_factory=lambda: Found("missing"))
    seconds: float = 0.0

    def outcome(self, job: Job) -> Outcome:
        """That of a run that has ended."""
        return Outcome(job, self.found, self.seconds, self.place)


@dataclass(frozen=True)
class Exchange:
    """A sweep's own folder. Runs go by their number in the sweep."""

    folder: Path

    @classmethod
    def create(cls, root: Path) -> Exchange:
        """A new one among the run folders of ``root``; raises ``BenchError`` where it can't be made."""
        name = f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(2)}"
        folder = root / SWEEP_FOLDER / name
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            # Nobody else may write there: the order is unpickled from it.
            folder.mkdir(mode=0o700)
        except OSError as error:
            raise BenchError(
                f"Can't make the folder {folder}: {error.strerror}. Give output= a place that you may write to."
            ) from error
        return cls(folder)

    def write(self, number: int, note: Note) -> None:
        """Tell of a run; raises ``BenchError`` where that can't be written."""
        write_json(self._file(number), asdict(note))

    def read(self, number: int) -> Note | None:
        """The last word on a run, or None before the first."""
        if not self._file(number).is_file():
            return None
        content: dict[str, Any] = read_json(self._file(number))
        return Note(**content | {"found": Found(**content["found"])})

    def stop(self) -> None:
        """Ask the workers to end their runs, and to begin no others."""
        (self.folder / _STOP).touch()

    def begin_no_more(self) -> None:
        """Ask the workers to begin no others."""
        (self.folder / _NO_MORE).touch()

    def stopped(self) -> bool:
        """Whether runs shall end."""
        return (self.folder / _STOP).exists()

    def may_begin(self) -> bool:
        """Whether runs shall still begin; not either when the folder is gone."""
        return self.folder.is_dir() and not (self.stopped() or (self.folder / _NO_MORE).exists())

    def remove(self) -> None:
        """Remove the folder with all that is in it."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _file(self, number: int) -> Path:
        return self.folder / f"run-{number}.json"
