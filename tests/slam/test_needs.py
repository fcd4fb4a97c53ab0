"""What a run will need, said before it begins: by hand, on made-up disks, and that a hopeless one writes nothing."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bench.cli import main
from bench.config import compose_run
from bench.errors import BenchError
from bench.registry import PluginConfig
from bench.slam.needs import Needs
from bench.slam.system import System
from plugins.mappers.gaussian import GaussianMapper
from plugins.mappers.none import NoMapper

TINY = ["dataset.frames=10", "dataset.width=160", "dataset.height=48", "tracker=groundtruth"]


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Makes every disk have so many bytes free."""

    def has_free(size: float) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=size))

    return has_free


def needs(folder: Path, **changes: Any) -> Needs:
    known = {"frames": 10, "renders": 6e6, "map": 3e6, "checkpoint": 1e6, "cache": 0.0, "memory_gb": None}
    return Needs(folder=folder, cache_folder=folder, **{**known, **changes})


def test_it_follows_from_the_images_and_what_is_rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = compose_run([*TINY, f"output={tmp_path / 'run'}", "cache.all=true"])
    system = System.build(config)
    both = Needs.of(system, config)
    left = Needs.of(replace(system, protocol=replace(system.protocol, right_view=False)), config)
    none = Needs.of(replace(system, mapper=NoMapper(PluginConfig())), config)
    # Ten pictures of 160x48 at 2.7 bytes a pixel a camera, beside a few kB of text.
    assert both.renders - left.renders == left.renders - none.renders == pytest.approx(10 * 160 * 48 * 2.7)
    assert both.cache == 10 * 160 * 48 * 4
    assert (none.map, none.checkpoint, none.cache) == (None, None, 0)
    assert "(renders 0.03 MB)" in none.line()
    assert both.map is not None
    assert both.memory_gb is None
    monkeypatch.setattr(type(system.dataset), "__len__", lambda self: 501)
    assert Needs.of(system, config).memory_gb == GaussianMapper.needs(system.mapper, 501).memory_gb


def test_what_is_scarce_is_said(tmp_path: Path, disk: Callable[[float], None]) -> None:
    disk(1e9)
    line = needs(tmp_path).line()
    assert line == (
        "10 frames need about 10 MB on disk (renders 6 MB, map 3 MB, checkpoint until it is done 1 MB); 1.0 GB free"
    )
    assert needs(tmp_path, memory_gb=2.5).line() == f"{line}; memory about 2.5 GB"
    assert "Warning: the cache may not fit" in needs(tmp_path, cache=2e9).line()
    disk(9.9e6)
    assert needs(tmp_path).line().endswith("9.9 MB free. Warning: it may not fit; make room, or choose another output=")
    (tmp_path / "views").write_bytes(bytes(200_000))  # of the run itself: it counts as free
    assert "Warning" not in needs(tmp_path).line()
    (tmp_path / "views").unlink()
    disk(0.99e6)
    with pytest.raises(BenchError, match=r"needs about 10 MB in .*, and 0\.99 MB are free there\. .*output=FOLDER"):
        needs(tmp_path).line()


def test_a_run_that_can_never_fit_is_refused_before_anything_is_written(
    tmp_path: Path, disk: Callable[[float], None], capsys: pytest.CaptureFixture[str]
) -> None:
    disk(1000.0)
    assert main(["run", *TINY, f"output={tmp_path / 'run'}"]) == 2
    assert "This run needs about " in capsys.readouterr().err
    assert not (tmp_path / "run" / "config.yaml").exists()
