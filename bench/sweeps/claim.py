"""The claim of one process to a run: while it lasts, no other process starts the same run."""

from __future__ import annotations

import os
from pathlib import Path

from bench.errors import BenchError
from bench.io.file_lock import holder, is_locked, knows_no_locks, lock, open_lock, write_holder

SWEEP_FOLDER = ".sweep"
"""Beside the run folders: a lock and a log for each run that was started."""


class Claim:
    """An open, locked file. The system lets go of it when every process that inherited it has ended, however.

    So the run's own process inherits it (``Popen(pass_fds=[claim.fd])``): should the sweep be killed, the run that goes
    on alone is still claimed. ``Claim.attempt`` makes one.
    """

    def __init__(self, fd: int) -> None:
        self.fd = fd

    @classmethod
    def attempt(cls, run_folder: Path) -> Claim | None:
        """Claim the run of this folder, or None where another process has; raises ``BenchError`` for no lock file.

        On a file system without locks every claim is granted: the sweep has said so, and makes one run at a time.
        """
        path = claim_path(run_folder, "lock")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            fd = open_lock(path)
        except OSError as error:
            raise BenchError(
                f"Can't make {path}: {error.strerror}. Give output= a place that you may write to."
            ) from error
        if not _locked(fd):
            os.close(fd)
            return None
        claim = cls(fd)
        try:
            claim.note(os.getpid())
        except BenchError:
            claim.release()
            raise
        return claim

    def note(self, pid: int) -> None:
        """Write into the file which process does the work, for those who find it claimed.

        Raises ``BenchError`` where that can't be written.
        """
        try:
            write_holder(self.fd, pid)
        except OSError as error:
            raise BenchError(f"Can't write a sweep's lock file: {error.strerror}. Check the free space.") from error

    def release(self) -> None:
        """Let go of it (a process that inherited it still holds it)."""
        os.close(self.fd)


def _locked(fd: int) -> bool:
    try:
        return lock(fd, wait=False)
    except OSError as error:
        if not knows_no_locks(error):
            raise
        return True


def is_claimed(run_folder: Path) -> bool:
    """Whether some process has claimed the run."""
    return is_locked(claim_path(run_folder, "lock"))


def claimed_by(run_folder: Path) -> str:
    """Who has claimed the run, in words."""
    with claim_path(run_folder, "lock").open() as file:
        return holder(file.fileno())


def claim_path(run_folder: Path, what: str) -> Path:
    """The file beside the run folders that belongs to one: ``what`` is "lock" or "log"."""
    return run_folder.parent / SWEEP_FOLDER / f"{run_folder.name}.{what}"
