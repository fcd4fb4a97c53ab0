"""Other systems' scores in the tables: which row they fill, beside which published number, with which mark."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

# The builder of run folders with known numbers lives beside the tests of tables.
sys.path.insert(0, str(Path(__file__).parent.parent / "tables"))

from fake_runs import FRAMES, config, make_run, metrics

from bench.cli import main
from bench.tables.named.grid import CROSS, MINUS
from bench.tables.named.table import make_table


def foreign(name: str, sequence: str = "03", seed: int = 0, **section: Any) -> dict[str, Any]:
    ours = config(sequence, seed=seed)
    kept = {key: ours[key] for key in ("seed", "protocol", "dataset", "evaluator")}
    return kept | {"foreign": {"name": name, "content": f"{sequence}{seed}", "read_as": {"numbers": "auto"}, **section}}


def block_of(text: str, method: str) -> list[list[str]]:
    """Cells of the lines of a method in a Markdown table; a method's name stands in its first line only."""
    block: list[list[str]] = []
    inside = False
    for line in text.splitlines():
        cells = [cell.strip().replace("\\_", "_") for cell in line.strip("|").split("|")]
        inside = cells[0].rstrip("†") == method or (inside and cells[0] == "")
        if inside:
            block.append(cells)
    return block


def ate_in_03(text: str, method: str) -> list[str]:
    """Of our line and the paper's."""
    block = block_of(text, method)
    assert [line[1].partition(" ")[0] for line in block[:2]] == ["ATE", ""]
    assert block[0][2] == "ours"
    return [line[3] for line in block[:2]]


def main_kitti(folder: Path) -> str:
    return make_table("main_kitti", [folder]).text("md", folder)


def test_a_system_of_the_paper_is_compared_to_its_row(tmp_path: Path) -> None:
    """The paper's MonoGS has 57.87 m in 03, on the first 300 frames. The mean of two seeds here is 50.0 m."""
    for seed, error in ((0, 49.0), (1, 51.0)):
        scores = metrics(300, ate_rmse_m=error, psnr_db=20.0)
        make_run(tmp_path / f"monogs{seed}", foreign("monogs", seed=seed), scores)
    make_run(tmp_path / "ours", config("03"), metrics(FRAMES["03"], ate_rmse_m=1.5, psnr_db=22.0))
    text = main_kitti(tmp_path)
    scored, published = ate_in_03(text, "monogs (scored output)")
    assert scored.startswith("50.000 ± 1.414 (2)")
    # 50.00 - 57.87 = -7.87, in the paper's two digits.
    assert published == f"57.87 ({MINUS}7.87)"
    assert "| monogs (scored output)† |" in text
    assert "† 300 of 801 frames of 03: monogs (scored output)." in text
    assert "Scored here from the systems' own output: monogs (scored output)." in text
    assert "Settings that differ" not in text
    assert "belongs to no cell" not in text


def test_any_other_system_gets_a_row_below(tmp_path: Path) -> None:
    make_run(tmp_path / "a", foreign("VINGS-Mono"), metrics(FRAMES["03"], ate_rmse_m=2.5))
    make_run(tmp_path / "b", foreign("bgs_slam"), metrics(FRAMES["03"], ate_rmse_m=3.5))
    make_run(tmp_path / "c", config("03", system="bgs_slam"), metrics(FRAMES["03"], ate_rmse_m=4.5))
    text = main_kitti(tmp_path)
    names = ("VINGS-Mono", "bgs_slam", "bgs_slam (scored output)")
    numbers = [block_of(text, name)[0][3].partition(" ")[0].strip("*") for name in names]
    assert numbers == ["2.500", "4.500", "3.500"]
    order = [text.index(f"| {name} |") for name in ("bgs\\_slam\\_fast", "bgs\\_slam (scored output)", "VINGS-Mono")]
    assert order == sorted(order)
    # The ablation's rows are variants of one system.
    assert "VINGS" not in make_table("ablation", [tmp_path]).text("md", tmp_path)


def test_out_of_memory_is_a_cross(tmp_path: Path) -> None:
    made = foreign("Point-SLAM", resources={"peak_memory_gb": 48.0})
    make_run(tmp_path / "dead", made, None, "out_of_memory", 212, "48 GB were not enough")
    block = block_of(main_kitti(tmp_path), "Point-SLAM (scored output)")
    assert block[0][3].startswith(CROSS)


def test_protocols_that_differ_are_told(tmp_path: Path) -> None:
    made = foreign("SplaTAM")
    made["protocol"] = {"name": "heldout", "alignment": "se3"}
    scores = metrics(FRAMES["03"], ate_rmse_m=10.0)
    scores["protocol"]["name"] = "heldout"
    make_run(tmp_path / "a", made, scores)
    make_run(tmp_path / "b", config("03"), metrics(FRAMES["03"], ate_rmse_m=1.5))
    text = main_kitti(tmp_path)
    assert "protocol.name (heldout, paper)" in text
    assert "tracker" not in text.partition("Settings that differ")[2].partition(".\n")[0]


@pytest.mark.parametrize("form", ["csv", "tex", "html"])
def test_every_format_has_them(tmp_path: Path, form: str) -> None:
    make_run(tmp_path / "a", foreign("SplaTAM"), metrics(FRAMES["03"], ate_rmse_m=9.75))
    text = make_table("main_kitti", [tmp_path]).text(form, tmp_path)
    assert "9.75" in text


def test_the_table_of_runs_and_that_of_dialects_call_it_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scores = metrics(FRAMES["03"], ate_rmse_m=9.75, psnr_db=20.0)
    scores["dialects"] = {"splatam": {"n_views": 3, "psnr_db": 21.0, "ate_m": 9.0, "stamp": {}}}
    make_run(tmp_path / "a", foreign("LoopSplat"), scores)
    assert main(["table", str(tmp_path)]) == 0
    assert "│ LoopSplat " in capsys.readouterr().out
    assert "LoopSplat kitti 03" in make_table("dialects", [tmp_path]).text("md", tmp_path)
