"""A tracker that goes on from its state says what it would have said without the break, to the bit.

Loops are closed after a break in ``tests/tracking/loops/test_stereo_orb_loops.py``.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.io.array_store import ArrayStore
from bench.registry import lookup
from bench.tracking import growing
from bench.tracking.loops import place_list, places
from bench.types import StereoFrame, TrackingResult
from bench.weights import locate


def build(name: str, dataset: Dataset, store: ArrayStore, **settings: Any) -> Tracker:
    plugin = lookup("tracker", name)
    tracker: Tracker = plugin.cls(plugin.config(name=name, **settings))
    tracker.start(dataset)
    tracker.use_store(store)
    return tracker


def said(tracker: Tracker, result: TrackingResult) -> list[Any]:
    trajectory = tracker.trajectory()
    arrays = [result.T_world_cam, result.landmarks, trajectory.T_world_cam, trajectory.numbers, trajectory.timestamps]
    return [result.state, result.inliers, result.events, *(None if a is None else a.tobytes() for a in arrays)]


def twin(name: str, dataset: Dataset, tracker: Tracker, folder: Path, **settings: Any) -> Tracker:
    """A fresh instance with the state of ``tracker``, through a file, and a store with the sets that it names."""
    file, store = io.BytesIO(), ArrayStore(folder)
    torch.save(tracker.state(), file)
    state = torch.load(io.BytesIO(file.getvalue()), weights_only=True)
    for each in state.get("stored", ()):
        store.put(each, ArrayStore(folder.parent / "first").get(each))
    again = build(name, dataset, store, **settings)
    again.restore(state)
    return again


def follow(
    name: str, dataset: Dataset, frames: list[StereoFrame], breaks: Sequence[int], folder: Path, **settings: Any
) -> list[TrackingResult]:
    """Track all frames; after each of ``breaks`` a twin goes on for the next three, and must say the same."""
    tracker, results = build(name, dataset, ArrayStore(folder / "first"), **settings), []
    twins: list[tuple[int, Tracker]] = []
    for position, frame in enumerate(frames):
        results.append(tracker.track(frame))
        for since, other in twins:
            assert said(other, other.track(frame)) == said(tracker, results[-1]), (since, position)
        twins = [(since, other) for since, other in twins if position < since + 3]
        if position in breaks:
            twins.append((position, twin(name, dataset, tracker, folder / f"after-{position}", **settings)))
    return results


def black(frame: StereoFrame) -> StereoFrame:
    return StereoFrame(frame.number, frame.timestamp, np.zeros_like(frame.left), np.zeros_like(frame.right))


@pytest.fixture
def small_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few rows and places fill a group, so that the store is used."""
    for module, name in ((growing, "_GROUP"), (places, "BLOCK"), (place_list, "BLOCK")):
        monkeypatch.setattr(module, name, 3)


@pytest.mark.usefixtures("small_groups")
@pytest.mark.parametrize("features", ["orb", "xfeat"])
def test_odometry_goes_on_also_while_it_is_lost(wall: Any, tmp_path: Path, features: str) -> None:
    if features == "xfeat" and locate("xfeat") is None:
        pytest.skip("no XFeat weights; get them with `bgs-bench weights get xfeat`")
    frames = [wall.frame(k) for k in range(12)]
    frames[5:8] = [black(frame) for frame in frames[5:8]]
    settings: dict[str, Any] = {"features": features, "keypoints": 400, "bridge_frames": 1}
    results = follow("stereo_orb", wall, frames, (0, 4, 5, 6, 7, 8), tmp_path, **settings)
    assert [result.state for result in results[5:8]] == ["lost"] * 3
    assert results[-1].state == "ok"


@pytest.mark.parametrize("name", ["groundtruth", "trajectory_file"])
def test_given_poses_go_on(wall: Any, tmp_path: Path, name: str) -> None:
    settings: dict[str, Any] = {"noise_m": 0.1, "noise_deg": 0.5}
    if name == "trajectory_file":
        poses = wall.ground_truth().T_world_cam[:, :3].reshape(12, 12).copy()
        poses[6] = np.nan
        np.savetxt(tmp_path / "poses.txt", poses)
        settings = {"path": str(tmp_path / "poses.txt")}
    follow(name, wall, [wall.frame(k) for k in range(12)], (0, 5, 6, 10), tmp_path, **settings)
