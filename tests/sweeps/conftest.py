"""A KITTI root of a few pictures, and sweeps whose runs are fakes."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
from fake_bench import Bench, is_running

from bench.sweeps import plan, sweep
from tests.datasets.kitti_disk import write_kitti


@pytest.fixture(scope="session")
def kitti(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A KITTI root with sequence 03 (4 frames) and 06 (2 frames)."""
    root = tmp_path_factory.mktemp("kitti")
    write_kitti(root, frames=4, sequence="03")
    write_kitti(root, frames=2, sequence="06")
    return root


@pytest.fixture
def make_bench(tmp_path: Path, kitti: Path) -> Iterator[Callable[[str], Bench]]:
    """Makes a ``Bench`` in a new folder of this name; what still runs at the end is ended."""
    before = plan.arguments_of, sweep._POLL_S
    made: list[Bench] = []

    def make(name: str) -> Bench:
        made.append(Bench(tmp_path / name, kitti))
        return made[-1]

    yield make
    plan.arguments_of, sweep._POLL_S = before
    for bench in made:
        for process in bench.processes:
            process.kill()
        for marker in bench.control.glob("hangs-*"):
            if is_running(int(marker.read_text())):
                os.kill(int(marker.read_text()), signal.SIGKILL)
