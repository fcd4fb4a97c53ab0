"""A lock between processes: whoever holds it may do what only one should do at a time."""

from __future__ import annotations

import errno
import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def exclusive(path: Path) -> Iterator[None]:
    """Hold the lock file ``path`` (made when missing, empty, never removed) for the length of the block.

    Waits while another process or thread holds it; the system lets go of the lock of a process that dies. Raises
    ``OSError`` where the file can't be made.
    """
    file = open_lock(path)
    try:
        lock(file, wait=True)
        yield
    finally:
        os.close(file)


def open_lock(path: Path) -> int:
    """The lock file, made when missing; a child process inherits it (and its lock) only where it is handed over.

    Who opened it closes it, and with that lets go of the lock. Raises ``OSError`` where it can't be made.
    """
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def lock(file: int, wait: bool) -> bool:
    """Lock an open file; False where somebody else holds it, unless told to wait until they let go.

    Raises ``OSError`` on file systems without locks.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    return True


def has_locks(folder: Path) -> bool:
    """Whether the file system of a folder, which must be there, has locks (some of the network have none).

    Raises ``OSError`` where nothing can be written there.
    """
    with tempfile.TemporaryFile(dir=folder) as file:
        try:
            return lock(file.fileno(), wait=False)
        except OSError as error:
            if knows_no_locks(error):
                return False
            raise


def knows_no_locks(error: OSError) -> bool:
    """Whether this is what ``lock`` raises on a file system without locks."""
    return error.errno in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


def is_locked(path: Path) -> bool:
    """Whether anybody holds the lock file; False where there is none, and on a file system without locks."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as error:
        if not knows_no_locks(error):
            raise
    finally:
        os.close(file)
    return False


def write_holder(file: int, pid: int) -> None:
    """Write into the open lock file which process does the work, for those who find it locked. Raises ``OSError``."""
    os.ftruncate(file, 0)
    os.pwrite(file, f"{pid}\n".encode(), 0)


def holder(file: int) -> str:
    """Who holds the open lock file, in words."""
    text = os.pread(file, 100, 0).decode(errors="replace").strip()
    return f"process {text}" if text else "another process"
