"""Where a run folder lies, seen from a table."""

from __future__ import annotations

import os
from pathlib import Path


def relative(run: Path, folder: Path) -> str:
    """Path of ``run`` relative to ``folder``, with forward slashes."""
    return Path(os.path.relpath(run.resolve(), folder.resolve())).as_posix()
