"""Runs of a tiny street through the command line, and plugins of a user that misbehave."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.short_runs import FEW_ITERATIONS

SMALL = ("dataset.frames=4", "dataset.width=160", "dataset.height=64", *FEW_ITERATIONS, "protocol.lpips=false")
TINY = (*SMALL, "tracker=groundtruth", "mapper.exposure=false")

TRACKER = '''
"""Trackers that stop in frame 2, each in its way."""
import time
from dataclasses import dataclass
from pathlib import Path

from bench.registry import register
from plugins.trackers.groundtruth import GroundTruth, GroundTruthConfig


@dataclass(frozen=True)
class StoppingConfig(GroundTruthConfig):
    how: str = "raise"
    marker: str = ""


@register("tracker", "stopping_for_tests", config=StoppingConfig)
class Stopping(GroundTruth):
    """Ground truth that does something else in frame 2."""

    def __init__(self, config):
        super().__init__(config)
        self._config = config

    def track(self, frame):
        if frame.number == 2:
            if self._config.how == "raise":
                raise ValueError("the tracker is\\nbroken")
            if self._config.how == "memory":
                raise MemoryError
            Path(self._config.marker).touch()
            time.sleep(3)
        return super().track(frame)
'''


def command(arguments: Sequence[str]) -> list[str]:
    """The command line of ``bgs-bench`` with these arguments, in this Python."""
    return [sys.executable, "-m", "bench.cli", *arguments]


def environment() -> dict[str, str]:
    """One thread, and a wide terminal, so that a message is one line."""
    return os.environ | {"OMP_NUM_THREADS": "1", "COLUMNS": "400"}


def bgs_bench(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run ``bgs-bench`` in a fresh process; its working folder is ``cwd``."""
    return subprocess.run(
        command(arguments), capture_output=True, text=True, cwd=cwd, env=environment(), timeout=180, check=False
    )


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """The folder of one tiny run, made by the command line, and what it printed. Copy it before you change it."""
    place = tmp_path_factory.mktemp("finished")
    return place / "run", bgs_bench("run", *TINY, f"output={place / 'run'}", cwd=place)


@pytest.fixture(scope="session")
def stopping_plugin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of plugins with the tracker ``stopping_for_tests``."""
    folder = tmp_path_factory.mktemp("plugins")
    (folder / "stopping.py").write_text(TRACKER)
    return folder
