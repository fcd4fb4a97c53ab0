"""The bench as a Python package: ``bench.run``, ``score``, ``table``, ``load_runs`` and ``load_map``. Importing it
costs nothing: torch and the rest are imported when one of these is first asked for."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bench.commands.run import run_overrides as run
    from bench.commands.score import score_saved as score
    from bench.commands.table import table_document as table
    from bench.saved_map import load_map
    from bench.tables.frame import load_runs

DISTRIBUTION = "bgs-slam-bench"
"""What this package is installed as."""

__all__ = ["load_map", "load_runs", "run", "score", "table"]

_PLACES = {
    "run": ("bench.commands.run", "run_overrides"),
    "score": ("bench.commands.score", "score_saved"),
    "table": ("bench.commands.table", "table_document"),
    "load_runs": ("bench.tables.frame", "load_runs"),
    "load_map": ("bench.saved_map", "load_map"),
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # As the command line does, before torch is imported.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    module, function = _PLACES[name]
    found = getattr(importlib.import_module(module), function)
    globals()[name] = found
    return found
