"""Places among which independent workers of one machine share out its cores and GPUs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.io.file_lock import lock, open_lock

_POLL_S = 0.1


@dataclass(frozen=True)
class Slots:
    """``count`` lock files in ``folder``; slot k has the GPU k of ``gpus``, in turn where there are fewer."""

    folder: Path
    count: int
    gpus: tuple[str, ...]

    @contextmanager
    def one(self, while_waiting: Callable[[], None]) -> Iterator[tuple[int, int]]:
        """A free slot and its locked file, during the block; waits for one, and calls ``while_waiting`` meanwhile.

        A process that inherits the file keeps the slot taken, should this one be killed.
        """
        slot, file = self._take(while_waiting)
        try:
            yield slot, file
        finally:
            os.close(file)

    def _take(self, while_waiting: Callable[[], None]) -> tuple[int, int]:
        while True:
            for slot in range(self.count):
                file = open_lock(self.folder / f"slot-{slot}")
                if lock(file, wait=False):
                    return slot, file
                os.close(file)
            while_waiting()
            time.sleep(_POLL_S)
