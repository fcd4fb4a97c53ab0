"""An end of a run like that by SIGKILL, inside the test's process."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from bench.runs.checkpoint import Checkpoints


class _Killed(BaseException):
    """Ends a run where SIGKILL would."""


@contextmanager
def killed_after(checkpoints: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The run inside ends when so many checkpoints have been written; nothing is saved then."""
    written, write = itertools.count(1), Checkpoints._write

    def count(self: Checkpoints, snapshot: Any) -> None:
        write(self, snapshot)
        if next(written) == checkpoints:
            raise _Killed

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "_write", count)
        patch.setattr("bench.slam.run.save_outputs", lambda *nothing: None)
        with pytest.raises(_Killed):
            yield
