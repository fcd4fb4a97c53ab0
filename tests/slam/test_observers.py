"""Who follows a run: it is told what the run has, changes no bit of it, and can't spoil it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from killed_run import killed_after

from bench.config import compose_run
from bench.contracts.map_view import MapView
from bench.contracts.observer import FrameDone, Observer, RunBegins, numbers_in
from bench.registry import register
from bench.slam.run import run_system
from bench.types import Trajectory

# So small chunks that Gaussians lie on disk, and the sky moves between keyframes.
TINY = ("dataset.frames=6", "dataset.width=160", "dataset.height=64", "mapper.iterations=3", "protocol.lpips=false")
TINY += ("mapper.final_coarse_iterations=1", "mapper.final_iterations=1", "mapper.chunk_m=1", "mapper.live_m=2")
TINY += ("tracker=groundtruth", "protocol.right_view=false", "protocol.holdout_every=4")


class Watching(Observer):
    """Notes all that it is told, and looks at everything."""

    told: ClassVar[list[tuple[str, Any]]]
    fails_at: ClassVar[str | None]

    def __init__(self, config: object) -> None:
        pass

    def _note(self, moment: str, what: Any = None) -> None:
        self.told.append((moment, what))
        if moment == self.fails_at:
            raise RuntimeError("no more\nof this")

    def begin(self, run: RunBegins) -> None:
        self._note("begin", run)

    def frame(self, done: FrameDone) -> None:
        if done.map is not None:
            points = done.map.points(100)
            assert points is not None
            assert 0 < len(points.positions) <= 100
            assert np.isfinite(points.positions).all()
            assert points.colors.dtype == np.uint8
        self._note("frame", done)

    def optimised(self, trajectory: Trajectory, map: MapView | None) -> None:
        self._note("optimised", trajectory)

    def scored(self, metrics: Mapping[str, Any]) -> None:
        self._note("scored", metrics)

    def end(self) -> None:
        self._note("end")


@register("viewer", "watching_for_tests")
class WatchingViewer(Watching):
    """As a viewer."""

    told: ClassVar[list[tuple[str, Any]]] = []
    fails_at: ClassVar[str | None] = None


@register("logger", "watching_for_tests")
class WatchingLogger(Watching):
    """As a logger."""

    told: ClassVar[list[tuple[str, Any]]] = []
    fails_at: ClassVar[str | None] = None


FOLLOWED = ("viewer=watching_for_tests", "logger=[watching_for_tests]")


@pytest.fixture(autouse=True)
def _nothing_told() -> None:
    for each in (WatchingViewer, WatchingLogger):
        each.told, each.fails_at = [], None


def run(output: Path, *overrides: str) -> Path:
    return run_system(compose_run([*TINY, f"output={output}", *overrides])).path


def bits_of(folder: Path) -> dict[str, bytes]:
    """The files that say what came out, but for times."""
    files = ["map.ply", "events.jsonl", "trajectory.csv", *(f"views/left/color/00000{n}.png" for n in range(6))]
    return {name: (folder / name).read_bytes() for name in files}


@pytest.fixture(scope="module")
def unwatched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("whole") / "run")


def moments(cls: type[Watching]) -> list[str]:
    return [moment for moment, _ in cls.told]


@pytest.mark.slow
def test_a_watched_run_has_the_same_bits_and_one_that_fails_is_told_once(
    tmp_path: Path, unwatched: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    WatchingViewer.fails_at = "frame"
    with caplog.at_level(logging.WARNING, "bench"):
        folder = run(tmp_path / "run", *FOLLOWED)
    assert bits_of(folder) == bits_of(unwatched)
    assert moments(WatchingViewer) == ["begin", "frame"]
    (line,) = capsys.readouterr().err.splitlines()
    assert "viewer=watching_for_tests failed and is left out from here on; the run goes on." in line
    assert line.endswith("RuntimeError: no more of this")
    assert [record.exc_info is not None for record in caplog.records if "viewer=" in record.message] == [True]
    assert moments(WatchingLogger) == ["begin", *6 * ["frame"], "optimised", "end"]
    begun = WatchingLogger.told[0][1]
    assert (begun.folder, list(begun.numbers), begun.first, begun.first_number) == (folder, [*range(6)], 0, 0)
    assert len(begun.ground_truth) == 6
    frames = [done for moment, done in WatchingLogger.told if moment == "frame"]
    mapped = [done.keyframe is not None for done in frames]
    assert mapped[0]
    assert not mapped[2]  # held out
    for done, is_mapped in zip(frames, mapped, strict=True):
        assert (done.losses is not None) == (done.trajectory is not None) == is_mapped
    scalars = frames[0].scalars()
    assert {"psnr_while_mapping", "gaussians", "memory_gb", "mapping_s", "loss/rgb"} <= scalars.keys()
    assert not {"number", "timestamp", "mapped"} & scalars.keys()


@pytest.mark.slow
def test_a_resumed_run_is_followed_from_where_it_goes_on(
    tmp_path: Path, unwatched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with killed_after(3, monkeypatch):
        run(tmp_path / "run", "checkpoint_s=0")
    folder = run(
        tmp_path / "run", "checkpoint_s=0", *FOLLOWED
    )  # followed only now: the checkpoint is good all the same
    assert bits_of(folder) == bits_of(unwatched)
    assert WatchingViewer.told[0][1].first == WatchingViewer.told[0][1].first_number == 3
    assert [done.row["number"] for moment, done in WatchingViewer.told if moment == "frame"] == [3, 4, 5]


def test_they_are_no_part_of_the_run(tmp_path: Path) -> None:
    """Its hash is the same, and a run that is made again from a folder is not sent where the folder says."""
    plain, followed = compose_run([]), compose_run([*FOLLOWED, f"output={tmp_path / 'run'}"])
    assert followed.hash == plain.hash
    assert [each.name for each in followed.several("logger")] == ["watching_for_tests"]
    assert plain.several("viewer") == plain.several("logger") == []


def test_numbers_of_nested_data() -> None:
    values = {"a": {"b": 1, "c": None, "d": True}, "e": "1", "f": float("nan"), "g": np.float32(0.5)}
    assert numbers_in(values) == {"a/b": 1.0, "g": 0.5}
