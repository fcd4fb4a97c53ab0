"""The lock of a run folder: of several processes that start the same run, one makes it and the others wait for it."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.errors import BenchError
from bench.io.file_lock import holder, lock, open_lock, write_holder
from bench.runs.config_file import CONFIG_FILE

LOCK_FILE = ".lock"

log = logging.getLogger(__name__)


@contextmanager
def only_one(folder: Path, on_wait: Callable[[str], None]) -> Iterator[None]:
    """Hold the lock of a run folder during the block; the folder is made, and removed again if it stays empty.

    While another process holds the lock, ``on_wait`` is told who, once, and this one waits; the system lets go of the
    lock of a process that dies. On file systems without locks there is none, and the log says so. Raises ``BenchError``
    where the folder can't be made.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    ours = not (folder / LOCK_FILE).exists()
    file = _locked(folder, on_wait)
    try:
        yield
    finally:
        if ours and not (folder / CONFIG_FILE).exists():
            _remove(folder, made)
        os.close(file)


def _locked(folder: Path, on_wait: Callable[[str], None]) -> int:
    """The open lock file, locked."""
    path = folder / LOCK_FILE
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            file = open_lock(path)
        except OSError as error:
            if folder.exists() and not folder.is_dir():
                raise BenchError(f"output={folder} is a file. Name a folder that is empty or not there yet.") from error
            raise BenchError(
                f"Can't make the run folder {folder}: {error.strerror}. Give output= a place that you may write to."
            ) from error
        try:
            _acquire(file, folder, on_wait)
            if path.exists() and path.stat().st_ino == os.fstat(file).st_ino:
                return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)  # whoever held it removed the empty folder: begin again


def _acquire(file: int, folder: Path, on_wait: Callable[[str], None]) -> None:
    try:
        if not lock(file, wait=False):
            on_wait(holder(file))
            lock(file, wait=True)
    except OSError as error:
        log.warning("no lock on %s (%s): don't start the same run twice", folder, error.strerror)
        return
    try:
        write_holder(file, os.getpid())
    except OSError:
        log.debug("the lock file of %s can't be written: those who wait won't be told for whom", folder)


def _remove(folder: Path, made: list[Path]) -> None:
    """No run came of it, as when the input is wrong: the lock goes, and the folders that were made for it."""
    try:
        (folder / LOCK_FILE).unlink()
        for path in made:
            path.rmdir()
    except OSError:  # someone has deleted it, or put something there, meanwhile: then it is theirs
        return
