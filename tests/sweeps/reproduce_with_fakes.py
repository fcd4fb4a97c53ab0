"""``bgs-bench`` whose sweeps have fakes in place of runs: ``python reproduce_with_fakes.py CONTROL reproduce ...``."""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from omegaconf import OmegaConf

from bench.cli import main
from bench.config import RunConfig
from bench.sweeps import plan, sweep
from bench.sweeps.plan import PlannedRun
from bench.tables.named.definitions import Cell

_compose_cell = plan.compose_cell
# Composing a row takes most of a sweep's time, and the sweeps of these tests have the same rows.
_composed: dict[tuple[str, ...], RunConfig] = {}
_COMPOSED_FILE = "composed.pickle"


def composed_once(cell: Cell, overrides: Sequence[str]) -> RunConfig:
    """The run of a cell, composed only when it is asked for first."""
    key = tuple(overrides)
    if key not in _composed:
        _composed[key] = _compose_cell(cell, overrides)
    return _composed[key]


def remember_composed(control: Path) -> None:
    """For a process that is to have the fakes of ``control``: what this one has composed."""
    (control / _COMPOSED_FILE).write_bytes(pickle.dumps(_composed))


@contextmanager
def fakes(control: Path) -> Iterator[None]:
    """Sweeps of this process start ``fake_run.py`` meanwhile; what each does stands in ``control/behaviour.json``."""

    def arguments_of(planned: PlannedRun) -> list[str]:
        job = control / f"{planned.config.hash}.json"
        config = f"# bgs-bench run, config hash {planned.config.hash}\n"
        config += OmegaConf.to_yaml(OmegaConf.create(planned.config.values))
        content = {"folder": str(planned.folder), "label": planned.label, "seed": planned.seed, "config": config}
        job.write_text(json.dumps(content))
        return ["-S", str(Path(__file__).with_name("fake_run.py")), str(job)]

    before = plan.arguments_of, sweep._POLL_S, plan.compose_cell
    plan.arguments_of, sweep._POLL_S, plan.compose_cell = arguments_of, 0.01, composed_once
    try:
        yield
    finally:
        plan.arguments_of, sweep._POLL_S, plan.compose_cell = before


if __name__ == "__main__":
    _composed.update(pickle.loads((Path(sys.argv[1]) / _COMPOSED_FILE).read_bytes()))
    with fakes(Path(sys.argv[1])):
        sys.exit(main(sys.argv[2:]))
