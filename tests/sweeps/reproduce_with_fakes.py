"""``bgs-bench`` whose sweeps have fakes in place of runs: ``python reproduce_with_fakes.py CONTROL reproduce ...``."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omegaconf import OmegaConf

from bench.cli import main
from bench.sweeps import plan, sweep
from bench.sweeps.plan import PlannedRun


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

    before = plan.arguments_of, sweep._POLL_S
    plan.arguments_of, sweep._POLL_S = arguments_of, 0.01
    try:
        yield
    finally:
        plan.arguments_of, sweep._POLL_S = before


if __name__ == "__main__":
    with fakes(Path(sys.argv[1])):
        sys.exit(main(sys.argv[2:]))
