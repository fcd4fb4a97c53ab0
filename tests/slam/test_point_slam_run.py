"""A run with Point-SLAM's parts, killed and resumed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from killed_run import killed_after

from bench.config import compose_run
from bench.runs.folder import TRAJECTORY_FILE
from bench.slam.run import run_system

SETTINGS = (
    "system=point_slam_tum",
    "dataset=street",
    "dataset.frames=4",
    "dataset.width=64",
    "dataset.height=48",
    "tracker.iterations=2",
    "tracker.rays=40",
    "mapper.first_iterations=4",
    "mapper.first_geometry_iterations=2",
    "mapper.iterations=2",
    "mapper.rays=40",
    "mapper.uniform_pixels=300",
    "mapper.refinement_rounds=1",
    "checkpoint_s=0",
    "protocol.lpips=false",
)


@pytest.mark.slow
def test_killed_after_three_frames_it_ends_with_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run_system(compose_run([*SETTINGS, f"output={tmp_path / 'whole'}"])).path
    broken = compose_run([*SETTINGS, f"output={tmp_path / 'broken'}"])
    with killed_after(3, monkeypatch):
        run_system(broken)
    resumed = run_system(broken).path
    ours, theirs = np.load(whole / "points.npz"), np.load(resumed / "points.npz")
    assert set(ours) == set(theirs)
    for name in ours:
        np.testing.assert_array_equal(ours[name], theirs[name], err_msg=name)
    assert (whole / TRAJECTORY_FILE).read_bytes() == (resumed / TRAJECTORY_FILE).read_bytes()
    frames = pd.read_csv(resumed / "frames.csv")
    assert frames["left_color"].all()
    assert not frames["right_color"].any()
    assert frames["absent"].str.contains("depth of a view").all()
