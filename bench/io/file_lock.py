"""A lock between processes: whoever holds it may do what only one should do at a time."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def exclusive(path: Path) -> Iterator[None]:
    """Hold the lock file ``path`` (made when missing, empty, never removed) for the length of the block.

    Waits while another process or thread holds it; the system lets go of the lock of a process that dies. Raises
    ``OSError`` where the file can't be made.
    """
    with open(path, "ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
