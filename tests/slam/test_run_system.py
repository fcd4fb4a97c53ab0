"""The SLAM loop: who gets what, what is kept from the mapper, and how a run that goes wrong is recorded."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import spies
import torch

from bench.config import compose_run
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.runs.events import read_events
from bench.runs.folder import RunFolder
from bench.slam.run import run_system
from bench.types import Event, Keyframe, MappingReport, StereoFrame
from plugins.datasets.street import Street
from tests.short_runs import FEW_ITERATIONS

pytestmark = pytest.mark.slow

TINY = ("dataset.frames=5", "dataset.width=160", "dataset.height=64", *FEW_ITERATIONS, "protocol.lpips=false")


def run(output: Path, *overrides: str) -> RunFolder:
    return run_system(compose_run([*TINY, f"output={output}", *overrides]))


def state_of(folder: Path) -> tuple[str, str, int]:
    status = json.loads((folder / "status.json").read_text())
    return status["state"], status["reason"], status["frames_done"]


def test_held_out_frames_never_reach_the_mapper(tmp_path: Path) -> None:
    """protocol.holdout_every=3 keeps out the frames whose number leaves remainder 2: here frame 2. They are tracked."""
    options = ["mapper=spy_for_tests", "tracker=groundtruth", "protocol.holdout_every=3"]
    folder = run(tmp_path / "run", *options)
    seen = spies.SpyMapper.seen
    assert seen
    assert all(number % 3 != 2 for number, _ in seen)
    assert all(n % 3 != 2 for _, window in seen for n in window)
    assert all(number in window for number, window in seen)
    frames = pd.read_csv(folder.path / "frames.csv", index_col="number")
    assert frames["heldout"].tolist() == [False, False, True, False, False]
    assert not frames.loc[2, "mapped"]
    assert frames["state"].tolist() == ["ok"] * 5
    assert frames["mapped"].sum() == len(seen)
    assert (folder.path / "views/left/color/000002.png").is_file()  # rendered all the same
    assert spies.SpyMapper.finished == 1


def test_without_held_out_frames_the_mapper_sees_all_keyframes(tmp_path: Path) -> None:
    run(tmp_path / "run", "mapper=spy_for_tests", "tracker=groundtruth")
    assert 2 in [number for number, _ in spies.SpyMapper.seen]
    # The tracker's last word on all poses comes before the end.
    assert spies.SpyMapper.poses[-1].numbers.tolist() == [0, 1, 2, 3, 4]


def test_a_lost_frame_is_neither_mapped_nor_rendered(tmp_path: Path) -> None:
    folder = run(tmp_path / "run", "mapper=spy_for_tests", "tracker=odd_for_tests").path
    frames = pd.read_csv(folder / "frames.csv")
    assert frames["state"].tolist() == ["ok", "lost", "ok", "ok", "ok"]
    assert not frames["mapped"][1]
    assert 1 not in [number for number, _ in spies.SpyMapper.seen]
    assert not (folder / "views/left/color/000001.png").exists()
    assert (folder / "views/left/color/000002.png").exists()
    assert len((folder / "trajectory_kitti.txt").read_text().splitlines()) == 4
    assert Event("lost", 1) in read_events(folder)
    assert "frame 1: tracking is lost" in (folder / "log.txt").read_text()
    assert state_of(folder)[0] == "done"


def test_a_predicted_frame_has_a_pose_and_is_no_keyframe(tmp_path: Path) -> None:
    folder = run(tmp_path / "run", "mapper=spy_for_tests", "tracker=odd_for_tests", "tracker.answer=predicted").path
    frames = pd.read_csv(folder / "frames.csv")
    assert frames["state"].tolist() == ["ok", "predicted", "ok", "ok", "ok"]
    assert not frames["is_keyframe"][1]
    assert 1 not in [number for number, _ in spies.SpyMapper.seen]
    assert len((folder / "trajectory_kitti.txt").read_text().splitlines()) == 5
    assert Event("predicted", 1) in read_events(folder)


def test_a_run_that_lost_all_frames_but_the_first_has_failed(tmp_path: Path) -> None:
    """The pose that the world begins at is no trajectory, and one view is no score."""
    with pytest.raises(BenchError, match=r"^Tracking was lost in 4 of 5 frames: there is no run\. See the images, the"):
        run(tmp_path / "run", "tracker=odd_for_tests", "tracker.lost_from=1")
    state, reason, done = state_of(tmp_path / "run")
    assert (state, done) == ("failed", 5)
    assert reason.startswith("Tracking was lost in 4 of 5 frames")


@pytest.mark.parametrize(
    ("answer", "got"), [("nan", r"shape \(4, 4\) with NaN"), ("3x4", r"shape \(3, 4\)"), ("none", "None")]
)
def test_a_trackers_wrong_answer_is_named(tmp_path: Path, answer: str, got: str) -> None:
    message = rf"OddTracker\.track returned state 'ok' with a pose of {got} for frame 1; expected a finite 4x4 pose"
    with pytest.raises(BenchError, match=message):
        run(tmp_path / "run", "tracker=odd_for_tests", f"tracker.answer={answer}")
    state, reason, done = state_of(tmp_path / "run")
    assert (state, done) == ("failed", 1)
    assert reason.startswith("OddTracker.track returned")


def test_what_ended_the_run_is_reported_even_when_saving_breaks_too(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="the tracker broke"):
        run(tmp_path / "run", "tracker=odd_for_tests", "tracker.answer=raise", "tracker.trajectory_fails=true")
    assert state_of(tmp_path / "run") == ("failed", "RuntimeError: the tracker broke", 1)
    log = (tmp_path / "run" / "log.txt").read_text()
    assert "no trajectory either" in log
    assert (tmp_path / "run" / "frames.csv").is_file()


@pytest.mark.parametrize(
    ("make", "state"),
    [
        (MemoryError, "out_of_memory"),
        (lambda: torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB"), "out_of_memory"),
        (lambda: RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried"), "out_of_memory"),
        (lambda: OSError(28, "No space left on device"), "failed"),
        (KeyboardInterrupt, "interrupted"),
    ],
)
def test_state_of_a_run_that_ends_early(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[], BaseException], state: str
) -> None:
    def finish(self: object) -> None:
        raise make()

    monkeypatch.setattr(spies.SpyMapper, "final_steps", finish)
    with pytest.raises(type(make())):
        run(tmp_path / "run", "mapper=spy_for_tests", "tracker=groundtruth", "dataset.frames=2")
    assert state_of(tmp_path / "run")[0] == state
    assert (tmp_path / "run" / "map.ply").is_file()


def test_running_ahead_changes_no_bit(tmp_path: Path) -> None:
    """pipeline=parallel lets the front end run ahead of mapping in a thread; the tracker here does real work."""
    options = ["tracker=stereo_orb", "dataset.width=320", "dataset.height=96", "dataset.frames=4"]
    one, other = (run(tmp_path / p, *options, f"pipeline={p}").path for p in ("parallel", "sequential"))
    for name in ("map.ply", "trajectory.csv", "views/left/color/000003.png", "views/right/depth/000002.png"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    tables = [pd.read_csv(folder / "frames.csv").filter(regex="^(?!.*_s$|memory_gb$)") for folder in (one, other)]
    pd.testing.assert_frame_equal(*tables)


@pytest.mark.parametrize("pipeline", ["parallel", "sequential"])
def test_an_error_of_the_mapper_ends_the_front_end_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pipeline: str
) -> None:
    """What was done is saved as of that frame, although the front end was ahead, and no thread goes on working."""
    add = spies.SpyMapper.add_keyframe

    def fails_in_frame_1(self: spies.SpyMapper, keyframe: Keyframe, window: tuple[int, ...]) -> MappingReport:
        if keyframe.frame.number == 1:
            raise ValueError("the mapper broke")
        return add(self, keyframe, window)

    monkeypatch.setattr(spies.SpyMapper, "add_keyframe", fails_in_frame_1)
    with pytest.raises(ValueError, match="the mapper broke"):
        run(tmp_path / "run", "mapper=spy_for_tests", "tracker=groundtruth", f"pipeline={pipeline}")
    assert state_of(tmp_path / "run") == ("failed", "ValueError: the mapper broke", 1)
    assert len((tmp_path / "run/trajectory_kitti.txt").read_text().splitlines()) == 1
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("bgs-")]


def test_progress_is_told_frame_by_frame(tmp_path: Path) -> None:
    told: list[tuple[int, int, float]] = []
    config = compose_run([*TINY, "tracker=groundtruth", f"output={tmp_path / 'run'}"])
    run_system(config, lambda *progress: told.append(progress))
    assert [(done, total) for done, total, _ in told] == [(k, 5) for k in range(1, 6)]
    assert np.isfinite(told[-1][2])


def test_runs_outside_the_main_thread(tmp_path: Path) -> None:
    """Signals can't be handled there; launchers do run jobs in threads."""
    thread = threading.Thread(target=run, args=(tmp_path / "run", "tracker=groundtruth", "dataset.frames=1"))
    thread.start()
    thread.join(timeout=60)
    assert state_of(tmp_path / "run")[0] == "done"


def test_the_oracle_can_map_too(tmp_path: Path) -> None:
    """mapper.rasterizer=reference computes in float64 and serves a mapper that works in float32."""
    small = [
        "dataset.width=64",
        "dataset.height=32",
        "dataset.frames=1",
        "mapper.iterations=2",
        "mapper.seeding.stride=4",
    ]
    folder = run(tmp_path / "run", "tracker=groundtruth", "mapper.rasterizer=reference", *small[2:], *small[:2])
    assert state_of(folder.path)[0] == "done"


def test_one_frame_is_a_run(tmp_path: Path) -> None:
    assert state_of(run(tmp_path / "run", "tracker=groundtruth", "dataset.frames=1").path) == ("done", "", 1)


def test_a_run_without_a_map_tracks_and_computes_no_stereo(tmp_path: Path) -> None:
    folder = run_system(compose_run([*TINY[:3], "mapper=none", f"output={tmp_path / 'run'}"]))
    frames = pd.read_csv(folder.path / "frames.csv")
    assert state_of(folder.path) == ("done", "", 5)
    assert frames["is_keyframe"].any()
    assert not frames["mapped"].any()
    assert (frames["stereo_s"] == 0).all()
    assert not (folder.path / "views").exists()
    assert not (folder.path / "map.ply").exists()
    metrics = evaluate_run(folder.path)
    assert metrics["trajectory"]["n"] == 5
    assert metrics["notes"]["image"] == "the run saved no renders"
    assert "lpips" not in metrics["notes"]


def test_what_a_data_set_tells_is_a_warning_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Street, "remarks", ("2 images have no partner",))
    folder = run_system(compose_run([*TINY[:3], "mapper=none", "tracker=groundtruth", f"output={tmp_path / 'run'}"]))
    assert json.loads((folder.path / "status.json").read_text())["warnings"] == ["2 images have no partner"]
    assert "2 images have no partner" in (folder.path / "log.txt").read_text()


def sky_at(numbers: set[int], monkeypatch: pytest.MonkeyPatch, standing: range = range(0)) -> None:
    """The street, but for frames that see nothing but sky, and a stretch in which the car stands still."""
    frame = Street.frame

    def seen(self: Street, position: int) -> StereoFrame:
        moved = position - len([each for each in standing if each < position])
        there = frame(self, standing[0] if position in standing else moved)
        sky = np.full_like(there.left, (150, 190, 240))
        left, right = (sky, sky) if position in numbers else (there.left, there.right)
        return replace(there, number=position, timestamp=position * 0.1, left=left, right=right)

    monkeypatch.setattr(Street, "frame", seen)


def test_standing_still_for_three_seconds_adds_rows_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """30 equal frames; after them one that is all sky is lost, and the next is found again."""
    sky_at({35}, monkeypatch, standing=range(3, 33))
    settings = ("dataset.frames=37", "dataset.width=320", "dataset.height=96", "protocol.right_view=false")
    folder = run(tmp_path / "run", *settings, "mapper.final_coarse_iterations=0", "mapper.final_iterations=0")
    rows = pd.read_csv(folder.path / "frames.csv")
    assert rows["number"].tolist() == list(range(37))
    assert not rows["mapped"][5:33].any()
    assert rows["mapped"][3:33].sum() <= 2
    assert rows["state"].tolist() == ["ok"] * 35 + ["lost", "ok"]
    still = pd.read_csv(folder.path / "trajectory.csv").query("5 <= number < 33").filter(like="T_").to_numpy()
    np.testing.assert_allclose(still, np.broadcast_to(still[0], still.shape), atol=1e-3)
    assert state_of(folder.path)[::2] == ("done", 37)


def test_a_frame_that_is_all_sky_is_mapped_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sky_at({2}, monkeypatch)
    folder = run(tmp_path / "run", "dataset.frames=4", "tracker=groundtruth", "mapper.final_coarse_iterations=1")
    assert state_of(folder.path) == ("done", "", 4)
    assert folder.has_view("left", 2)
    assert any("knew no depth at all in 1 of " in warning for warning in folder.warnings)
    evaluate_run(folder.path)
    assert np.isfinite(pd.read_csv(folder.path / "per_frame.csv")["psnr_db"]).all()
