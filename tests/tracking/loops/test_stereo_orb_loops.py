"""The tracker ``stereo_orb`` with loop closing: its settings, real images without a loop, and a street driven round."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch  # before gtsam, as in the bench

import plugins.trackers.stereo_orb as plugin_file
from bench.contracts.dataset import Dataset
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.io.array_store import ArrayStore
from bench.plugin_config import plugin_config_from
from bench.registry import lookup
from bench.runs.events import in_words
from bench.tracking import growing
from bench.tracking.loops import place_list, places
from bench.tracking.loops.settings import LoopSettings
from bench.tracking.loops.vocabulary import train
from bench.types import Event, StereoCamera, StereoFrame, Trajectory

pytest.importorskip("gtsam")


def stereo_orb(**settings: Any) -> Tracker:
    plugin = lookup("tracker", "stereo_orb")
    return plugin.cls(plugin.config(name="stereo_orb", **settings))


def drive(tracker: Tracker, dataset: Dataset) -> tuple[Trajectory, list[Event]]:
    tracker.start(dataset)
    events = [event for position in range(len(dataset)) for event in tracker.track(dataset.frame(position)).events]
    return tracker.trajectory(), events


class Kitti(Dataset):
    """Frames 0-50 of KITTI 06, grey; calibration as in the data set's calib.txt."""

    def __init__(self, root: Path) -> None:
        self.label, self.numbers = "kitti/06", tuple(range(51))
        self.camera = StereoCamera(1226, 370, 707.0912, 707.0912, 601.8873, 183.1104, (379.8145 / 707.0912, 0.0, 0.0))
        self._folder = root / "sequences" / "06"

    def frame(self, position: int) -> StereoFrame:
        images = [cv2.imread(str(self._folder / side / f"{position:06d}.png"), 0) for side in ("image_0", "image_1")]
        left, right = (np.dstack([image] * 3) for image in images if image is not None)
        return StereoFrame(position, 0.1 * position, left, right)


@pytest.mark.slow
def test_a_straight_real_road_closes_nothing(kitti_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Searched as eagerly as can be: after 5 places, for loops of 8 m, whatever drift they imply."""
    eager = LoopSettings(training_places=5, min_way_m=8.0, min_similarity=0.0, max_drift=1.0, min_inliers=15)
    tracker, asked = stereo_orb(loops=eager), []
    real = plugin_file.LoopCloser._follow
    monkeypatch.setattr(plugin_file.LoopCloser, "_follow", lambda self, s: (asked.append(len(s)), real(self, s)))
    with_loops, events = drive(tracker, Kitti(kitti_root))
    without, _ = drive(stereo_orb(loop_closure=False), Kitti(kitti_root))
    assert not events
    assert len(asked) > 15
    assert np.array_equal(with_loops.T_world_cam, without.T_world_cam)


def ate_m(trajectory: Trajectory, truth: Trajectory) -> float:
    """RMS after the best rigid motion of the centres (Kabsch)."""
    a, b = trajectory.T_world_cam[:, :3, 3], truth.T_world_cam[trajectory.numbers][:, :3, 3]
    U, _, Vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return float(np.sqrt((((a - a.mean(0)) @ R.T - (b - b.mean(0))) ** 2).sum(axis=1).mean()))


def broken_drive(
    dataset: Dataset, breaks: tuple[int, ...], folder: Path, **settings: Any
) -> tuple[Trajectory, list[Event]]:
    """As ``drive``; after each of ``breaks`` another tracker, which goes on from what a checkpoint holds, must say the
    same of the next two frames."""
    tracker, store, events = stereo_orb(**settings), ArrayStore(folder / "first"), []
    tracker.start(dataset)
    tracker.use_store(store)
    twins: dict[int, Tracker] = {}
    for position in range(len(dataset)):
        result = tracker.track(dataset.frame(position))
        events += result.events
        for since, twin in twins.items():
            again = twin.track(dataset.frame(position))
            assert (again.state, again.inliers, again.events) == (result.state, result.inliers, result.events)
            assert np.array_equal(twin.trajectory().T_world_cam, tracker.trajectory().T_world_cam), since
        twins = {since: twin for since, twin in twins.items() if position < since + 2}
        if position in breaks:
            twins[position], kept = stereo_orb(**settings), ArrayStore(folder / str(position))
            torch.save(tracker.state(), folder / "state.pt")
            state = torch.load(folder / "state.pt", weights_only=True)
            for name in state["stored"]:
                kept.put(name, store.get(name))
            twins[position].start(dataset)
            twins[position].use_store(kept)
            twins[position].restore(state)
    return tracker.trajectory(), events


@pytest.mark.slow
def test_a_street_with_repeated_facades_closes_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And says the same after a break before, at and after the closure. Few places fill a group, so that many are
    read from the store."""
    for module, name in ((growing, "_GROUP"), (places, "BLOCK"), (place_list, "BLOCK")):
        monkeypatch.setattr(module, name, 8)
    street = lookup("dataset", "street")
    drive_at = {"frames": 70, "speed_m": 4.0, "circuit_m": 240, "width": 512, "height": 160}
    dataset = street.cls(street.config(name="street", repeated_facades=True, **drive_at))
    truth = dataset.ground_truth()
    assert truth is not None
    breaks = (30, 59, 60, 61, 62)
    closed, events = broken_drive(dataset, breaks, tmp_path, keypoints=1200)
    assert {event.kind for event in events} == {"loop_closed"}
    first = events[0]
    # One lap is 60 frames; the place may be that of a frame or so beside.
    assert 60 <= first.frame < 70
    assert abs(first.frame - first.values["to_frame"] - 60) <= 2
    assert {first.frame - 1, first.frame} <= set(breaks)
    assert first.values["keyframes_moved"] <= first.values["keyframes"]
    assert in_words(first).startswith("loop closed: frame 6")
    assert ate_m(closed, truth) < 0.001 * 276
    # The same place on both laps, but for the 0.2 m by which the car wanders in its lane.
    assert np.linalg.norm(closed.T_world_cam[69, :3, 3] - closed.T_world_cam[9, :3, 3]) < 0.6


def test_loop_closing_needs_gtsam_and_only_then(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent() -> None:
        raise BenchError("Loop closing needs gtsam")

    monkeypatch.setattr(plugin_file, "import_gtsam", absent)
    with pytest.raises(BenchError, match="needs gtsam"):
        stereo_orb()
    stereo_orb(loop_closure=False)


def test_settings_are_nested_typed_and_checked() -> None:
    config = plugin_config_from("tracker", {"name": "stereo_orb", "loops": {"min_matches": 5}})
    assert config.loops == LoopSettings(min_matches=5)  # type: ignore[attr-defined]
    with pytest.raises(BenchError, match="min_match"):
        plugin_config_from("tracker", {"name": "stereo_orb", "loops": {"min_match": 5}})
    with pytest.raises(BenchError, match=r"tracker\.loops\.min_inliers=3 is too small; the least is 15\."):
        stereo_orb(loops=LoopSettings(min_inliers=3))


def test_a_vocabulary_is_read_from_its_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    vocabulary = train([rng.integers(0, 2**64, (300, 4), dtype=np.uint64) for _ in range(3)], 5, 2)
    vocabulary.save(tmp_path / "small.npz")
    tracker = stereo_orb(vocabulary=str(tmp_path / "small.npz"))
    assert len(tracker._vocabulary) == len(vocabulary)  # type: ignore[attr-defined]
    with pytest.raises(BenchError, match=r"none\.npz does not exist"):
        stereo_orb(vocabulary=str(tmp_path / "none.npz"))
