"""A folder of another system's output, and where its run folder goes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.external.foreign_case import COUNT, curve, write_depth, write_poses, write_renders


@pytest.fixture
def no_plot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing the trajectory takes most of the time of a tiny run; test_same_evaluators.py has it drawn."""
    monkeypatch.setattr("bench.report.trajectory_plot.write_trajectory_plot", lambda *_: None)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """Where the run folder goes, in a folder of its own."""
    (tmp_path / "runs").mkdir()
    return tmp_path / "runs" / "run"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Everything, as a system might leave it: poses off by 0.1 m in turn, images by 4, depth by 0.5 m."""
    T = curve(np.arange(COUNT))
    T[:, 1, 3] += 0.1 * (-1.0) ** np.arange(COUNT)
    write_poses(tmp_path / "theirs" / "est.txt", T)
    write_renders(tmp_path / "theirs" / "eval" / "rendered_rgb", range(COUNT))
    write_depth(tmp_path / "theirs" / "depth", range(COUNT), 12.5)
    return tmp_path / "theirs"
