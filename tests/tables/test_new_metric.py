"""A user's evaluator is one file: its metric stands in every form of a table, also where the file is gone."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

from bench.contracts.metric import Metric
from bench.errors import BenchError
from bench.runs.folder import RunFolder

EVALUATOR = """
from bench.contracts.evaluator import Evaluator
from bench.contracts.metric import Metric
from bench.registry import register


@register("evaluator", "odometer")
class Odometer(Evaluator):
    '''Half the number of frames.'''

    metrics = (Metric("half_frames_hf", "Half frames", "hf", "higher", 2, "odometer.half"),)

    def __init__(self, config):
        pass

    def evaluate(self, run):
        return {"odometer": {"half": len(run.frames) / 2}}
"""


def bgs_bench(*arguments: object) -> str:
    """What the command prints, in a process that knows no plugin but those that it loads itself."""
    command = [sys.executable, "-m", "bench.cli", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout


@pytest.fixture
def scored(tmp_path: Path) -> Path:
    """Two runs of three and five frames, scored by the evaluator of a folder that is deleted afterwards."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "odometer.py").write_text(EVALUATOR)
    for name, frames in (("a", 3), ("b", 5)):
        config = {"plugins": [str(folder)], "evaluator": {"odometer": {"name": "odometer"}}, "dataset": {"name": "x"}}
        run = RunFolder.create(tmp_path / "runs" / name, config, "h", rerun=False)
        row = {"timestamp": 0.0, "state": "ok", "mapped": False, "heldout": False}
        run.write_frames([{"number": number} | row for number in range(frames)])
        run.write_json("resources.json", {"size": ["points"], "points": 1200 * frames})
        run.set_status("done", "", frames, frames)
        bgs_bench("evaluate", run.path, f"plugins=[{folder}]")
    (folder / "odometer.py").unlink()
    return tmp_path / "runs"


@pytest.mark.slow
def test_a_new_metric_is_in_every_form(scored: Path, tmp_path: Path) -> None:
    """Title, unit and decimals; the size of a map that is no Gaussian one too, and no column of Gaussians."""
    record = tmp_path / "all.runs.json"
    files = {suffix: tmp_path / f"all.{suffix}" for suffix in ("md", "csv", "tex", "html")}
    printed = bgs_bench("table", scored, "--out", *files.values(), record)
    texts = {suffix: file.read_text() for suffix, file in files.items()}
    for text in (printed, texts["md"], texts["tex"], texts["html"]):
        assert "Half frames" in text
        assert "[hf]" in text
        assert "2.50" in text
        assert "Points" in text
        assert "6,000" in text
        assert "Gaussians" not in text
    rows = list(csv.DictReader(texts["csv"].splitlines()))
    assert [(row["half_frames_hf"], row["points"]) for row in rows] == [("1.5", "3600"), ("2.5", "6000")]
    assert json.loads(record.read_text())["runs"][1]["metrics"]["odometer"] == {"half": 2.5}
    bgs_bench("table", record, "--out", tmp_path / "again.md", tmp_path / "again.csv")
    assert (tmp_path / "again.md").read_text() == texts["md"]
    assert (tmp_path / "again.csv").read_text() == texts["csv"]


def test_a_metric_is_found_at_its_path() -> None:
    metrics = {"views": {"left": {"psnr_db": 20.0, "ssim": None}}, "resources": {"a": 1.5, "b": 2, "c": "slow"}}
    assert Metric("psnr_db", "PSNR", path="views.left.psnr_db").value_in(metrics) == 20.0
    assert Metric("ssim", "SSIM", path="views.left.ssim").value_in(metrics) is None
    assert Metric("other", "Other", path="views.right.psnr_db").value_in(metrics) is None
    assert Metric("sum", "Sum", path="resources.a + resources.b + resources.c").value_in(metrics) == 3.5
    assert Metric("views", "Views").value_in(metrics) is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"key": "a b"}, "The metric key 'a b' must consist of letters"),
        ({"better": "more"}, "better of the metric m='more' is not one of higher, lower"),
        ({"column": "seldom"}, "column of the metric m='seldom' is not one of always, known, never"),
        ({"decimals": -1}, "The metric m can't have -1 decimals"),
    ],
)
def test_wrong_declarations_are_named(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Metric(**({"key": "m", "title": "M"} | wrong))  # type: ignore[arg-type]
