"""``bench.run``, ``table``, ``load_runs`` and ``load_map``: what the commands do, from Python; ``bench.score`` is
tested in tests/external."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import bench
from bench.cli import main
from bench.config import compose_run
from bench.errors import BenchError
from bench.hydra_settings import typed_overrides
from bench.types import PinholeView
from tests.short_runs import FEW_ITERATIONS, SMALL_STREET
from tests.tables.fake_runs import config, make_run, metrics

TINY = (*SMALL_STREET, *FEW_ITERATIONS, "protocol.lpips=false", "tracker=groundtruth", "mapper.exposure=false")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bench.run(TINY, output=tmp_path_factory.mktemp("run") / "it's, a run")


def test_importing_costs_nothing() -> None:
    code = "import sys, bench; print(sorted({'torch', 'pandas', 'numpy', 'cv2', 'hydra'} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True).stdout == "[]\n"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        bench.nothing  # noqa: B018


def test_a_run_is_made_and_scored_once(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (made / "metrics.json").stat().st_mtime_ns
    assert bench.run(TINY, output=made) == made
    assert (made / "metrics.json").stat().st_mtime_ns == before
    assert capsys.readouterr().out == ""
    with pytest.raises(BenchError, match="no setting 'frame'"):
        bench.run({"dataset": {"frame": 2}})


def test_settings_as_a_mapping_are_those_that_are_typed() -> None:
    settings = {
        "stereo": "sgbm",
        "mapper": {"iterations": 3, "seeding.ground": False},
        "loss": ["rgb", "ssim"],
        "seed": 1,
    }
    typed = ["stereo=sgbm", "mapper.iterations=3", "mapper.seeding.ground=false", "loss=[rgb,ssim]", "seed=1"]
    assert compose_run(typed_overrides(settings)).values == compose_run(typed).values
    assert typed_overrides("seed=1") == ["seed=1"]


def test_runs_as_a_frame(tmp_path: Path) -> None:
    for name, seed, iterations, psnr in (("a", 0, 60, 20.0), ("b", 1, 60, 22.0), ("c", 0, 80, None)):
        scores = metrics(1101, psnr_db=psnr, ate_rmse_m=0.5)
        make_run(tmp_path / name, config("06", seed=seed, mapper__iterations=iterations), scores)
    runs = bench.load_runs(tmp_path)
    assert runs["run"].tolist() == ["a", "b", "c"]
    assert runs["path"].tolist() == [str(tmp_path / name) for name in "abc"]
    assert runs["seed"].tolist() == [0, 1, 0]
    assert runs["mapper.iterations"].tolist() == [60, 60, 80]
    np.testing.assert_array_equal(runs["psnr_db"], [20.0, 22.0, np.nan])
    assert runs.groupby("mapper.iterations")["psnr_db"].mean()[60] == 21.0
    averaged = bench.load_runs(tmp_path / "a", str(tmp_path / "[bc]"), average=True)
    assert averaged["n"].tolist() == [2, 1]
    assert averaged["psnr_db_std"][0] == pytest.approx(2**0.5)
    with pytest.raises(BenchError, match="Nothing here is called like"):
        bench.load_runs(str(tmp_path / "x*"))


def test_a_table_is_that_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, seed, psnr in (("a", 0, 20.0), ("b", 1, 22.0)):
        make_run(tmp_path / name, config("06", seed=seed), metrics(1101, psnr_db=psnr, ate_rmse_m=0.5))
    runs = bench.table(str(tmp_path / "[ab]"))
    assert runs.frame()["psnr_db"].tolist() == [21.0]
    assert runs.frame()["psnr_db_std"][0] == pytest.approx(2**0.5)
    named = bench.table(tmp_path, name="main_kitti", columns="ours")
    for table, arguments in ((runs, []), (named, ["main_kitti", "--columns", "ours"])):
        for form in ("md", "csv", "tex"):
            assert main(["table", *arguments, str(tmp_path), "--format", form]) == 0
            assert table.text(form) == capsys.readouterr().out
    numbers = named.frame()
    assert numbers["by"].unique().tolist() == ["ours"]
    of_06 = numbers[numbers["sequence"] == "06"].dropna(subset="value").set_index("metric")["value"]
    assert of_06[["psnr_db", "ate_rmse_m"]].astype(float).tolist() == [21.0, 0.5]
    for wrong in ({"name": "main_kiti"}, {"name": "main_kitti", "columns": "mine"}, {"views": "right"}):
        with pytest.raises(BenchError, match=r"main_kitti|ours|named table"):
            bench.table(tmp_path, **wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("right", [False, True])
def test_a_map_shows_what_its_run_showed(made: Path, right: bool) -> None:
    loaded = bench.load_map(made)
    view = loaded.view_of(1, right)
    drawn = loaded.render(view)
    side = "right" if right else "left"
    saved = cv2.imread(str(made / f"views/{side}/color/000001.png"))[..., ::-1]
    assert saved.std() > 10
    assert np.abs(255 * drawn.color - saved).max() <= 1.0
    depth = cv2.imread(str(made / f"views/{side}/depth/000001.png"), cv2.IMREAD_UNCHANGED) / 256
    assert np.abs(drawn.depth - depth)[depth > 0].max() <= 1 / 256
    assert (drawn.alpha >= 0).all()
    assert (drawn.alpha <= 1 + 1e-6).all()
    np.testing.assert_array_equal(loaded.render(view.T_world_cam).color, drawn.color)  # the run's camera
    K = [[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]]
    file = bench.load_map(made / "map.ply")
    assert len(file) == len(loaded) > 100
    np.testing.assert_array_equal(file.render(view.T_world_cam, view.width, view.height, K).color, drawn.color)
    part = file.render(view.T_world_cam, 40, 30, K)
    # Not to the bit: how a Gaussian is flattened depends on where the image ends.
    np.testing.assert_allclose(part.color, drawn.color[:30, :40], atol=0.01)


EYE, K = np.eye(4), np.array([[50.0, 0, 20], [0, 50, 15], [0, 0, 1]])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((EYE,), "has no camera of its own"),
        ((EYE, 40, 30), "all of width, height and K"),
        ((EYE[:3], 40, 30, K), r"\(4, 4\) matrix"),
        ((2 * EYE + np.diag([0, 0, 0, -1]), 40, 30, K), "is no rotation"),
        ((np.diag([1.0, 1, -1, 1]), 40, 30, K), "is no rotation"),
        ((EYE, 0, 30, K), "positive numbers of pixels"),
        ((EYE, 40, 30, K + np.eye(3, k=1)), "no skew"),
        ((PinholeView(EYE, 50, 50, 20, 15, 40, 30), 40), "give these with a pose only"),
    ],
)
def test_a_wrong_view_is_no_picture(made: Path, arguments: tuple[Any, ...], text: str) -> None:
    with pytest.raises(BenchError, match=text):
        bench.load_map(made / "map.ply").render(*arguments)


def test_a_run_that_is_not_finished_has_no_map_yet(made: Path, tmp_path: Path) -> None:
    run = shutil.copytree(made, tmp_path / "run")
    (run / "map.ply").unlink()
    with pytest.raises(BenchError, match="There is no map"):
        bench.load_map(run)
    (run / "status.json").write_text((run / "status.json").read_text().replace('"done"', '"interrupted"'))
    with pytest.raises(BenchError, match=r"has no map yet: it is not finished\. Resume it"):
        bench.load_map(run)
    with pytest.raises(BenchError, match="has no frames; give a run folder"):
        bench.load_map(made / "map.ply").view_of(1)
