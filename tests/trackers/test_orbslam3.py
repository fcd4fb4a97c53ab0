"""Real ORB-SLAM3 as tracker: its files, its maps, and itself where pyorbslam3 is installed."""

from __future__ import annotations

import importlib.util
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.geometry import se3
from bench.registry import lookup
from bench.types import StereoFrame, TrackingResult, Trajectory
from plugins.trackers.orbslam3 import OrbSlam3
from plugins.trackers.orbslam3_process import Located, merged_maps, read_saved, settings_text

needs_orbslam3 = pytest.mark.skipif(
    importlib.util.find_spec("pyorbslam3") is None, reason="pyorbslam3 is not installed (extra [orbslam3])"
)


def tracker(**settings: Any) -> OrbSlam3:
    plugin = lookup("tracker", "orbslam3")
    return plugin.cls(plugin.config(name="orbslam3", **settings))


def track(slam: OrbSlam3, dataset: Dataset, kill_before: int = -1) -> list[TrackingResult]:
    slam.start(dataset)
    results = []
    for position in range(len(dataset)):
        if position == kill_before:
            assert slam._peer is not None
            os.kill(slam._peer.pid, signal.SIGKILL)
        results.append(slam.track(dataset.frame(position)))
    slam.finish()
    return results


def states(results: list[TrackingResult]) -> list[str]:
    return [result.state for result in results]


def errors_m(estimate: Trajectory, truth: Trajectory) -> np.ndarray:
    """Distance of the camera centres, first cameras aligned and nothing else."""
    of_truth = np.isin(truth.numbers, estimate.numbers)
    return np.linalg.norm(estimate.T_world_cam[:, :3, 3] - truth.T_world_cam[of_truth, :3, 3], axis=1)


class Blacked(Dataset):
    """A data set, some of whose frames see nothing."""

    def __init__(self, inner: Dataset, black: range) -> None:
        self._inner, self._black = inner, black
        self.label, self.camera, self.numbers = f"{inner.label}-black", inner.camera, inner.numbers

    def frame(self, position: int) -> StereoFrame:
        frame = self._inner.frame(position)
        if position not in self._black:
            return frame
        return StereoFrame(frame.number, frame.timestamp, np.zeros_like(frame.left), np.zeros_like(frame.right))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache folder of this test run's own; one vocabulary for all frames of the street."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("XDG_CACHE_HOME", str(folder))
        patch.delenv("PYORBSLAM3_VOCAB", raising=False)
        yield folder


class Kept(Dataset):
    """A data set whose frames are made once."""

    def __init__(self, inner: Dataset) -> None:
        self.label, self.camera, self.numbers = inner.label, inner.camera, inner.numbers
        self._frames = [inner.frame(position) for position in range(len(inner))]
        self._truth = inner.ground_truth()

    def frame(self, position: int) -> StereoFrame:
        return self._frames[position]

    def ground_truth(self) -> Trajectory | None:
        return self._truth


@pytest.fixture(scope="module")
def street() -> Kept:
    plugin = lookup("dataset", "street")
    # No longer: on images as small as these ORB-SLAM3 itself jumps by half a metre in frame 10.
    return Kept(plugin.cls(plugin.config(name="street", frames=10, width=640, height=192)))


def test_settings_are_written_under_orbslam3s_names() -> None:
    settings = {"fx": 700.0, "fy": 701.0, "cx": 600.5, "cy": 180.25, "width": 1226, "height": 370}
    settings |= {"baseline_m": 0.5, "features": 2000, "scale_factor": 1.2, "octaves": 8, "fast_threshold": 12}
    settings |= {"fast_threshold_low": 7, "th_depth": 40.0, "frame_rate_hz": 9.6, "vocabulary": "unused here"}
    header, *lines = settings_text(settings).strip().split("\n")
    assert header == "%YAML:1.0"
    written = dict(line.split(": ") for line in lines)
    assert float(written["Camera.bf"]) == 350.0
    assert float(written["Camera.fy"]) == 701.0
    assert written["ThDepth"] == "40.000000"  # it does not start from a whole number
    assert written["Camera.fps"] == "10"
    assert written["ORBextractor.minThFAST"] == "7"


def test_saved_poses_are_read_by_time(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    (tmp_path / "t.txt").write_text(
        f"0.000000 0 0 0 0 0 0 1\n0.100000 1 2 3 0 {half} 0 {half}\n0.200000 1 0 9 0 0 0 1\n0.200000 5 5 5 0 0 0 1\n"
    )
    saved = read_saved(tmp_path / "t.txt")
    assert list(sorted(saved)) == [0.0, 0.1, 0.2]
    np.testing.assert_allclose(saved[0.1], [[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1]], atol=1e-12)
    # The lines of lost frames repeat the time of the pose before; that pose is the right one.
    np.testing.assert_array_equal(saved[0.2][:3, 3], [1, 0, 9])


def located(number: int, which: int, z: float) -> Located:
    return Located(number, 0.1 * number, which, se3.exp(np.array([0, 0, z, 0, 0, 0])))


def test_a_map_that_no_longer_begins_at_its_origin_was_merged() -> None:
    frames = [located(0, 0, 0), located(1, 0, 1), located(5, 1, 0), located(6, 1, 1), located(9, 2, 30)]
    assert merged_maps(frames) == {0: 0, 1: 1, 2: 1}
    frames[2].T_map_cam[2, 3] = 14.0
    assert merged_maps(frames) == {0: 0, 1: 0, 2: 0}


def test_wrong_settings_are_named(tmp_path: Path, street: Kept) -> None:
    with pytest.raises(BenchError, match=r"tracker\.features=5 is too small; the least is 100"):
        tracker(features=5)
    with pytest.raises(BenchError, match=r"tracker\.fast_threshold=6 is below tracker\.fast_threshold_low=7"):
        tracker(fast_threshold=6)
    with pytest.raises(BenchError, match=r"tracker\.timeout_s=0\.0 must be above 0"):
        tracker(timeout_s=0.0)
    with pytest.raises(BenchError, match=r"tracker\.vocabulary=.*none\.txt can't be read \(No such file"):
        tracker(vocabulary=str(tmp_path / "none.txt")).start(street)
    (tmp_path / "v.txt").write_text("PK\x03\x04 no vocabulary")
    with pytest.raises(BenchError, match=r"v\.txt is no DBoW2 text vocabulary: its first line is not four whole"):
        tracker(vocabulary=str(tmp_path / "v.txt")).start(street)


def test_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert OrbSlam3.unavailable_reason() == (
        "pyorbslam3 (GPL-3; Linux x86-64) is not installed. Run: pip install 'bgs-slam-bench[orbslam3]'"
    )


@needs_orbslam3
def test_it_tracks_the_street(cache: Path, street: Kept) -> None:
    slam = tracker(features=1000)
    results = track(slam, street)
    assert states(results) == ["ok"] * 10
    assert min(result.inliers for result in results) > 50
    truth = street.ground_truth()
    assert truth is not None
    assert errors_m(slam.trajectory(), truth).max() < 0.2  # of 9 m
    assert slam._peer is None
    assert len(list((cache / "bgs-bench").iterdir())) == 1


@needs_orbslam3
def test_it_survives_its_own_death(cache: Path, street: Kept, caplog: pytest.LogCaptureFixture) -> None:
    slam = tracker(features=1000)
    results = track(slam, street, kill_before=4)
    assert states(results) == ["ok"] * 4 + ["lost", "predicted"] + ["ok"] * 4
    truth = street.ground_truth()
    assert truth is not None
    # The street's car does 1 m per frame, so constant velocity puts the second map well.
    assert errors_m(slam.trajectory(), truth).max() < 0.4
    assert "frame 4: orbslam3 was killed by SIGKILL" in caplog.text


@needs_orbslam3
def test_frames_that_see_nothing_are_lost_and_do_not_crash_it(cache: Path, street: Kept) -> None:
    slam = tracker(features=1000)
    results = track(slam, Blacked(street, range(4, 7)))
    assert states(results)[:7] == ["ok"] * 4 + ["lost"] * 3
    assert states(results)[-2:] == ["ok"] * 2
    assert np.isfinite(slam.trajectory().T_world_cam).all()


@needs_orbslam3
def test_ending_without_a_map_keeps_the_poses(cache: Path, street: Kept, caplog: pytest.LogCaptureFixture) -> None:
    slam = tracker(features=1000)
    track(slam, Blacked(street, range(4, 10)))
    assert slam.trajectory().numbers.tolist() == list(range(4))
    assert not [record for record in caplog.records if record.levelname == "WARNING"]


@needs_orbslam3
@pytest.mark.slow
def test_kitti_is_tracked_as_well_as_published(cache: Path, kitti_grey: Any) -> None:
    slam = tracker()
    assert states(track(slam, kitti_grey)) == ["ok"] * 51
    estimate = slam.trajectory().T_world_cam
    first, last = kitti_grey.ground_truth().T_world_cam[[0, 50]]
    error = se3.inverse(se3.inverse(first) @ last) @ se3.inverse(estimate[0]) @ estimate[50]
    # ORB-SLAM2's own paper gives 0.51 % on sequence 06; 60 m of it are a short piece, so twice that.
    assert np.linalg.norm(error[:3, 3]) / 59.9 < 0.0102
