"""The pictures of a run that ends while it renders: those that it made are kept, if they are of the same map."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from bench.config import compose_run
from bench.errors import BenchError
from bench.runs.folder import RunFolder
from bench.slam.run import run_system
from plugins.mappers.gaussian import GaussianMapper

FRAMES = 3
TINY = [f"dataset.frames={FRAMES}", "dataset.width=160", "dataset.height=64", "tracker=groundtruth"]
TINY += ["mapper.iterations=1", "mapper.final_coarse_iterations=1", "mapper.final_iterations=0", "checkpoint_s=1000"]
FULL = "Can't write a picture: No space left on device."


class _Killed(BaseException):
    """Ends a run where SIGKILL would."""


def run(folder: Path, *overrides: str) -> RunFolder:
    return run_system(compose_run([*TINY, f"output={folder}", *overrides]))


def pictures(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Bytes of each picture, and when it was written."""
    files = sorted((folder / "views").rglob("*.png"))
    return {str(file.relative_to(folder)): (file.read_bytes(), file.stat().st_mtime_ns) for file in files}


def same_bytes(some: dict[str, tuple[bytes, int]], others: dict[str, tuple[bytes, int]]) -> bool:
    return {name: content for name, (content, _) in some.items()} == {n: content for n, (content, _) in others.items()}


@contextmanager
def ends_in_view(number: int, how: str) -> Iterator[None]:
    """What begins view ``number`` (counted from 0) raises; a kill lets nothing be saved afterwards."""
    error = {"killed": _Killed(), "full": BenchError(FULL), "stopped": KeyboardInterrupt()}[how]
    with pytest.MonkeyPatch.context() as patch:
        begun, begin = [0], RunFolder.begin_view

        def count(self: RunFolder, *given: Any) -> Any:
            if begun[0] == number:
                raise error
            begun[0] += 1
            return begin(self, *given)

        patch.setattr(RunFolder, "begin_view", count)
        if how == "killed":
            patch.setattr("bench.slam.run.save_outputs", lambda *nothing: None)
        with pytest.raises(type(error)):
            yield


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("whole") / "run").path


@pytest.mark.parametrize("how", ["killed", "full"])
def test_only_what_is_missing_is_rendered_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unbroken: Path, how: str
) -> None:
    folder = tmp_path / "run"
    with ends_in_view(4, how):
        run(folder)
    made = pictures(folder)
    assert len(made) == 8  # colour and depth of four views
    if how == "full":
        status = json.loads((folder / "status.json").read_text())
        assert (status["state"], status["reason"], status["frames_done"]) == ("failed", FULL, FRAMES)
        assert (folder / "map.ply").read_bytes() == (unbroken / "map.ply").read_bytes()
    (folder / "views/left/depth/000001.png").unlink()  # half a view is none
    (folder / "views/left/color/.writing-1-0-000002.png").touch()
    rendered: list[tuple[int, bool]] = []
    render = GaussianMapper.render_frame

    def count(self: GaussianMapper, number: int, right: bool, *given: Any) -> Any:
        rendered.append((number, right))
        return render(self, number, right, *given)

    monkeypatch.setattr(GaussianMapper, "render_frame", count)
    monkeypatch.setattr(GaussianMapper, "add_keyframe", lambda *a: pytest.fail("mapped again"))
    monkeypatch.setattr(GaussianMapper, "final_steps", lambda *a: pytest.fail("optimised again"))
    run(folder)
    assert rendered == [(1, False), (2, False), (2, True)]
    assert same_bytes(pictures(folder), pictures(unbroken))
    kept = [name for name in made if not name.startswith("views/left") or "000001" not in name]
    assert [pictures(folder)[name] for name in kept] == [made[name] for name in kept]
    for name in ("map.ply", "trajectory.csv", "events.jsonl"):
        assert (folder / name).read_bytes() == (unbroken / name).read_bytes(), name
    assert not (folder / "checkpoint").exists()
    assert json.loads((folder / "status.json").read_text())["state"] == "done"


@pytest.mark.parametrize("why", ["resume=false", "other code", "checkpoint_s=inf"])
def test_views_of_another_attempt_are_never_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str) -> None:
    """The next attempt ends early, too: nobody may score what the one before has left."""
    folder = tmp_path / "run"
    with ends_in_view(4, "killed"):
        run(folder, "checkpoint_s=inf" if "inf" in why else "checkpoint_s=1000")
    assert len(pictures(folder)) == 8
    if why == "other code":
        monkeypatch.setattr("bench.runs.fingerprint.project_version", lambda: "of another day")
    with ends_in_view(0, "stopped"):
        run(folder, "resume=false" if why == "resume=false" else "resume=true")
    assert pictures(folder) == {}
