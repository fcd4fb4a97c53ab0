"""The scripts and the notebook of ``examples``, run on a street of a few frames."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import pytest

import bench

EXAMPLES = Path(__file__).parents[2] / "examples"
NOTEBOOK = EXAMPLES / "look_at_a_run.ipynb"
TINY: dict[str, Any] = {
    **{"dataset.width": 96, "dataset.height": 48, "cache.enabled": False, "tracker": "groundtruth"},
    **{"protocol.lpips": False, "mapper.exposure": False, "mapper.final_iterations": 1},
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the examples run, one after the other: a later one finds what an earlier one made."""
    return tmp_path_factory.mktemp("examples")


@pytest.fixture(autouse=True)
def _small(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def small_run(settings: dict[str, Any], **how: Any) -> Path:
        return make(settings | TINY, **how)

    make = bench.run
    monkeypatch.setattr(bench, "run", small_run)
    monkeypatch.chdir(place)
    matplotlib.use("agg")


@pytest.mark.slow
def test_the_scripts_run_in_their_order(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scripts = sorted(EXAMPLES.glob("*.py"))
    assert [script.name[:3] for script in scripts] == ["01_", "02_", "03_"]
    for script in scripts:
        runpy.run_path(str(script), run_name="__main__")
    said = capsys.readouterr().out
    assert "PSNR of the heldout views:" in said
    assert cv2.imread(str(place / "results/examples/view.png")).std() > 10
    assert cv2.imread(str(place / "results/examples/sweep.png")).shape == (720, 960, 3)


@pytest.mark.slow
def test_the_notebook_runs_and_is_kept_without_outputs() -> None:
    notebook = json.loads(NOTEBOOK.read_text())
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    names: dict[str, Any] = {}
    for cell in cells:
        exec("".join(cell["source"]), names)
    assert names["saved"].trajectory is not None
    assert {line.get_label() for line in names["figure"].axes[0].lines} <= {"left", "right"}
    assert names["drawn"].color.std() > 0.05
