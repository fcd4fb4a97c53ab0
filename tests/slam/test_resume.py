"""A run that is killed goes on from its last checkpoint, and ends with the bits of an unbroken run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import torch
from killed_run import killed_after

from bench.config import compose_run
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.runs.checkpoint import CHECKPOINT_FOLDER, Checkpoints
from bench.runs.events import read_events
from bench.runs.folder import RunFolder
from bench.slam.run import run_system
from plugins.mappers.gaussian import GaussianMapper
from plugins.trackers.groundtruth import GroundTruth
from plugins.trackers.stereo_orb import StereoOrb

STREET = ("dataset.frames=6", "dataset.width=320", "dataset.height=96", "mapper.iterations=3", "protocol.lpips=false")
STREET += (
    "mapper.final_coarse_iterations=1",
    "mapper.final_iterations=1",
    "mapper.cached_targets=2",
    "protocol.holdout_every=5",
)
# So that the map moves and is pruned, and events tell of it.
STREET += ("mapper.follow_corrections_m=0", "mapper.follow_corrections_deg=0", "mapper.prune_opacity=0.45")
SAME_BYTES = (
    "map.ply",
    "map_keyframes.npy",
    "events.jsonl",
    "trajectory.csv",
    "views/left/color/000005.png",
    "views/right/depth/000003.png",
)


def settings(output: Path, *overrides: str) -> list[str]:
    return [*STREET, "checkpoint_s=0", f"output={output}", *overrides]


def run(output: Path, *overrides: str) -> RunFolder:
    return run_system(compose_run(settings(output, *overrides)))


def killed_run(output: Path, monkeypatch: pytest.MonkeyPatch, after: int, *overrides: str) -> None:
    """Start a run and end it when its checkpoint number ``after`` has been written; nothing else of it is left."""
    with killed_after(after, monkeypatch):
        run(output, *overrides)
    assert (output / CHECKPOINT_FOLDER).is_dir()
    assert not (output / "map.ply").exists()


def quality(folder: Path) -> dict[str, Any]:
    """The metrics but for times and memory."""
    metrics = evaluate_run(folder)
    return {key: value for key, value in metrics.items() if key != "resources"}


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("whole") / "run", "checkpoint_s=inf").path


# Six frames, one of them held out, then two iterations for each of five keyframes.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("after", "pipeline", "frames_then", "repeats"),
    [(1, "parallel", 1, False), (4, "sequential", 4, False), (9, "parallel", 6, False), (3, "parallel", 3, True)],
)
def test_a_resumed_run_has_the_bits_of_an_unbroken_one(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    unbroken: Path,
    after: int,
    pipeline: str,
    frames_then: int,
    repeats: bool,
) -> None:
    """No frame is tracked twice, unless the tracker gives no state; then those before the break are."""
    folder = tmp_path / "run"
    if repeats:
        monkeypatch.setattr(StereoOrb, "state", lambda self: None)
    killed_run(folder, monkeypatch, after, f"pipeline={pipeline}")
    learned = []
    add = GaussianMapper.add_keyframe
    monkeypatch.setattr(GaussianMapper, "add_keyframe", lambda *a: learned.append(a[1].frame.number) or add(*a))
    tracked, track = [], StereoOrb.track
    monkeypatch.setattr(StereoOrb, "track", lambda *a: tracked.append(a[1].number) or track(*a))
    assert run(folder, f"pipeline={pipeline}").path == folder
    assert tracked == list(range(0 if repeats else frames_then, 6))
    assert learned == [
        number for number in range(frames_then, 6) if number != 2
    ]  # frame 2 is held out; none is learned twice
    assert {"map_moved", "pruned"} <= {event.kind for event in read_events(folder)}
    for name in SAME_BYTES:
        assert (folder / name).read_bytes() == (unbroken / name).read_bytes(), name
    tables = [pd.read_csv(each / "frames.csv").filter(regex="^(?!.*_s$|memory_gb$)") for each in (folder, unbroken)]
    pd.testing.assert_frame_equal(*tables)
    assert quality(folder) == quality(unbroken)
    assert not (folder / CHECKPOINT_FOLDER).exists()
    assert json.loads((folder / "provenance.json").read_text())["resumed_after_frames"] == [frames_then]
    assert "resumed from the checkpoint" in (folder / "log.txt").read_text()


@pytest.mark.slow
def test_a_run_can_be_broken_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unbroken: Path) -> None:
    folder = tmp_path / "run"
    killed_run(folder, monkeypatch, 2)
    killed_run(folder, monkeypatch, 2)  # two more checkpoints on
    run(folder)
    assert json.loads((folder / "provenance.json").read_text())["resumed_after_frames"] == [2, 4]
    assert (folder / "map.ply").read_bytes() == (unbroken / "map.ply").read_bytes()


@pytest.mark.slow
def test_tracking_can_be_broken_after_each_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tracked, track = [], StereoOrb.track
    monkeypatch.setattr(StereoOrb, "track", lambda *a: tracked.append(a[1].number) or track(*a))
    small = ["dataset.frames=4", "dataset.width=160", "dataset.height=64", "protocol.lpips=false", "mapper=none"]
    whole, folder = tmp_path / "whole", tmp_path / "run"
    run_system(compose_run([*small, f"output={whole}", "checkpoint_s=inf"]))
    broken = compose_run([*small, f"output={folder}", "checkpoint_s=0"])
    for count in range(4):
        tracked.clear()
        with killed_after(1, monkeypatch):
            run_system(broken)
        assert tracked[0] == count  # how far it was ahead of the break depends on threads
    tracked.clear()
    run_system(broken)
    assert not tracked
    for name in ("trajectory.csv", "events.jsonl"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes(), name
    tables = [pd.read_csv(each / "frames.csv").filter(regex="^(?!.*_s$|memory_gb$)") for each in (folder, whole)]
    pd.testing.assert_frame_equal(*tables)


@pytest.mark.slow
@pytest.mark.parametrize("override", ["resume=false", "rerun=true"])
def test_who_wants_no_resuming_gets_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, override: str) -> None:
    folder = tmp_path / "run"
    killed_run(folder, monkeypatch, 3)
    learned = []
    add = GaussianMapper.add_keyframe
    monkeypatch.setattr(GaussianMapper, "add_keyframe", lambda *a: learned.append(a[1].frame.number) or add(*a))
    run(folder, override)
    assert learned == [0, 1, 3, 4, 5]


@pytest.mark.slow
def test_changed_code_begins_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run"
    killed_run(folder, monkeypatch, 3)
    monkeypatch.setattr("bench.runs.fingerprint.project_version", lambda: "of another day")
    run(folder)
    assert "the run begins anew" in (folder / "log.txt").read_text()
    assert "resumed_after_frames" not in json.loads((folder / "provenance.json").read_text())


@pytest.mark.slow
def test_a_damaged_checkpoint_begins_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unbroken: Path) -> None:
    folder = tmp_path / "run"
    killed_run(folder, monkeypatch, 3)
    state = folder / CHECKPOINT_FOLDER / "state.pt"
    state.write_bytes(state.read_bytes()[:1000])
    run(folder)
    assert "is damaged" in (folder / "log.txt").read_text()
    assert (folder / "map.ply").read_bytes() == (unbroken / "map.ply").read_bytes()


def test_a_checkpoint_can_run_no_code(tmp_path: Path) -> None:
    """The unpickler is a restricted one: a file that would call a function is refused and the run begins anew."""

    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "was_here",))

    folder = tmp_path / "run" / CHECKPOINT_FOLDER
    folder.mkdir(parents=True)
    torch.save({"fingerprint": "f", "told": "{}", "mapper": Evil(), "random": None}, folder / "state.pt")
    assert Checkpoints(tmp_path / "run", "f", 0.0).load() is None
    assert not (tmp_path / "was_here").exists()


@pytest.mark.slow
def test_a_tracker_that_never_says_the_same_begins_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run"
    monkeypatch.setattr(GroundTruth, "state", lambda self: None)
    killed_run(folder, monkeypatch, 3, "tracker=groundtruth")
    track = GroundTruth.track

    def track_otherwise(self: GroundTruth, frame: Any) -> Any:
        result = track(self, frame)
        return type(result)(result.T_world_cam, result.state, inliers=frame.number)

    monkeypatch.setattr(GroundTruth, "track", track_otherwise)
    run(folder, "tracker=groundtruth")
    assert "tracking frame 1 again gives another result than before" in (folder / "log.txt").read_text()
    assert json.loads((folder / "status.json").read_text())["frames_done"] == 6


@pytest.mark.slow
def test_a_mapper_without_a_state_has_no_checkpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(GaussianMapper, "state", lambda self: None)
    monkeypatch.setattr(Checkpoints, "_write", lambda *nothing: pytest.fail("a checkpoint of nothing"))
    assert run(tmp_path / "run").path.is_dir()


@pytest.mark.slow
@pytest.mark.parametrize(("of", "method"), [(Checkpoints, "_write"), (GaussianMapper, "state")])
def test_a_checkpoint_that_cant_be_written_costs_no_run(
    of: type, method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: object, *of_state: Any) -> None:
        raise BenchError("Can't write it: No space left on device.")

    monkeypatch.setattr(of, method, full)
    folder = run(tmp_path / "run").path
    assert (folder / "log.txt").read_text().count("no checkpoint could be written") == 1
    assert json.loads((folder / "status.json").read_text())["state"] == "done"


@pytest.mark.slow
def test_times_and_memory_of_both_parts_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The parts' seconds add up; repeating the front end does not count twice."""
    folder = tmp_path / "run"
    killed_run(folder, monkeypatch, 4)
    told = json.loads(torch.load(folder / CHECKPOINT_FOLDER / "state.pt", weights_only=True)["told"])
    rows = [json.loads(line) for line in (folder / CHECKPOINT_FOLDER / "rows.jsonl").read_text().splitlines()]
    run(folder)
    frames = pd.read_csv(folder / "frames.csv")
    assert frames["tracking_s"][:4].tolist() == [row["tracking_s"] for row in rows]
    resources = json.loads((folder / "resources.json").read_text())
    for stage in ("tracking", "stereo"):
        assert resources[f"{stage}_s_per_frame"] * 6 == pytest.approx(frames[f"{stage}_s"].sum())
    assert resources["wall_s_per_frame"] * 6 > told["elapsed_s"]
    assert resources["peak_memory_gb"] >= told["peak_memory_gb"]


@pytest.mark.slow
def test_the_status_tells_of_frames_and_stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr("bench.runs.folder._TELL_S", -1.0)
    steps = GaussianMapper.final_steps

    def look(self: GaussianMapper) -> Iterator[None]:
        for step in steps(self):
            yield step
            seen.append(json.loads((tmp_path / "run" / "status.json").read_text()))

    monkeypatch.setattr(GaussianMapper, "final_steps", look)
    run(tmp_path / "run")
    assert {(s["state"], s["frames_done"], s["frames_total"], s["stage"]) for s in seen[1:]} == {
        ("running", 6, 6, "last optimisation")
    }


@pytest.mark.parametrize(
    "wrong",
    ["checkpoint_s=-1", "checkpoint_s=nan", "limits.memory_gb=0", "limits.hours=-2", "limits.stall_minutes=nan"],
)
def test_senseless_settings_are_refused(wrong: str) -> None:
    with pytest.raises(BenchError, match=wrong.partition("=")[0]):
        compose_run([wrong])


def test_how_it_is_run_is_no_part_of_what_is_run() -> None:
    one, other = compose_run([]), compose_run(["resume=false", "checkpoint_s=5", "limits.memory_gb=3"])
    assert one.hash == other.hash
