"""The tables of README.md and docs/: made from kept records, numbers worked out by hand, and never stale."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from fake_runs import config, make_run, metrics

from bench.cli import main
from bench.errors import BenchError
from bench.io.atomic import write_json
from bench.runs.events import write_events
from bench.tables.named.table import make_table
from bench.tables.records.folder import read_provenance
from bench.tracking.loops.closer import Closure
from plugins.trackers.stereo_orb import StereoOrb
from tools.doc_tables.blocks import Block, update
from tools.doc_tables.columns import by_settings, figures, number, read_kept
from tools.doc_tables.command import main as doc_tables
from tools.doc_tables.command import pages_with_tables
from tools.doc_tables.definitions import BLOCKS

ROOT = Path(__file__).parents[2]
SIMPLE = {"one": Block(("a.txt",), lambda kept, folder: f"{(kept / 'a.txt').read_text()} {folder.name}")}


def rows_of(markdown: str) -> list[list[str]]:
    lines = [line for line in markdown.splitlines() if line.startswith("|") and not line.startswith("|-")]
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines]


def test_no_page_is_older_than_its_records() -> None:
    shown = ""
    for page in pages_with_tables(ROOT):
        updated = update(page, ROOT / "results" / "tables", BLOCKS)
        assert not updated.stale, f"{page}, stale: {', '.join(updated.stale)}; run python -m tools.doc_tables"
        shown += updated.text
    assert all(f"<!-- table: {name} -->" in shown for name in BLOCKS if name != "dialects")


def test_only_what_is_between_the_markers_changes(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("made")
    file = tmp_path / "R.md"
    file.write_text("# x\n<!-- table: one -->\nold\n<!-- end -->\ntext\n<!-- table: one --><!-- end -->\n")
    updated = update(file, tmp_path, SIMPLE)
    block = f"<!-- table: one -->\nmade {tmp_path.name}\n<!-- end -->"
    assert updated.text == f"# x\n{block}\ntext\n{block}\n"
    assert updated.stale == ("one", "one")
    file.write_text(updated.text)
    assert update(file, tmp_path, SIMPLE).stale == ()


def test_a_table_without_its_record_stays_and_is_named(tmp_path: Path) -> None:
    file = tmp_path / "R.md"
    file.write_text("<!-- table: one -->\nby hand\n<!-- end -->\n")
    updated = update(file, tmp_path, SIMPLE)
    assert updated.text == file.read_text()
    assert updated.lacking == (f"one: there is no {tmp_path / 'a.txt'}",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x\n<!-- table: on -->\n<!-- end -->\n", r"R\.md: table='on' is not one of one\. Did you mean 'one'\?"),
        ("\n<!-- end -->\n", r"R\.md, line 2: <!-- end --> ends no table\. Put .* in pairs"),
        ("<!-- table: one -->\n<!-- table: one -->\n", r"line 2: <!-- table: one --> begins a table before"),
        ("<!-- table: one -->\n", r"R\.md: <!-- end --> of table one is missing"),
    ],
)
def test_markers_that_do_not_fit(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("made")
    (tmp_path / "R.md").write_text(text)
    with pytest.raises(BenchError, match=message):
        update(tmp_path / "R.md", tmp_path, SIMPLE)
    with pytest.raises(BenchError, match=r"Can't read .*none\.md"):
        update(tmp_path / "none.md", tmp_path, SIMPLE)


def scored(psnr: float, ate: float) -> dict[str, Any]:
    scores = metrics(10, psnr_db=psnr, depth_l1_cm=150.4, ate_rmse_m=ate, peak_memory_gb=0.9, wall_s_per_frame=2.0)
    scores["resources"] |= {"tracking_s_per_frame": 0.03, "stereo_s_per_frame": 0.1, "mapping_s_per_frame": 1.25}
    scores["trajectory"] |= {"t_rel_short_percent": ate, "rpe_trans_mean_m": ate / 10, "rpe_trans_rmse_m": ate / 5}
    scores["views"]["train"] = {"psnr_db": psnr + 1, "ssim": 0.8, "lpips": 0.125}
    scores["views"]["heldout"] = {"psnr_db": psnr - 1, "ssim": 0.7}
    return scores | {"map": {"gaussians": 253_400}}


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """Records of a few runs, made by the command as the README says."""
    runs, kept = tmp_path / "runs", tmp_path / "results" / "tables"
    for seed, psnr in ((0, 20.0), (1, 22.0)):
        make_run(runs / f"m{seed}", config("06", "bgs_slam", seed), scored(psnr, 0.5))
    make_run(runs / "lidar", config("06", "bgs_slam", stereo="lidar"), scored(15.0, 0.25))
    for seed, (ours, theirs) in enumerate([(0.2, 0.4), (0.1, 0.8), (0.9, 0.5)]):
        for name, error in (("stereo_orb", ours), ("orbslam3", theirs)):
            made = config("06", "bgs_slam", seed, tracker__name=name)
            make_run(tmp_path / "t" / f"{name}{seed}", made, scored(20.0, error))
    for seed in (2, 10, 1):
        made = config("06", dataset__name="street", dataset__seed=seed)
        run = make_run(tmp_path / "c" / f"street{seed}", made, scored(20.0, seed / 10))
        # As the tracker gives it.
        closure = Closure(
            old=0, new=1, poses=np.zeros((9, 4, 4)), inliers=99, loops=3, known=3, moved=8, farthest_m=5.3
        )
        closed = StereoOrb._event(cast(StereoOrb, SimpleNamespace(_number_of=[seed, 420 + seed].__getitem__)), closure)
        write_events(run, [closed] * 2)
        provenance = {"git": {"commit": "0123456789", "dirty": True}, "machine": {"cpu": "AMD", "usable_cores": 2}}
        write_json(run / "provenance.json", provenance)
    for name, folder in (("kitti06", runs), ("trackers", tmp_path / "t"), ("circuits", tmp_path / "c")):
        assert main(["table", str(folder), "--out", str(kept / f"{name}.runs.json")]) == 0
    return kept


def test_measured_rows_find_their_runs(kept: Path) -> None:
    """PSNR on training views 21 and 23 dB: mean 22, deviation sqrt(2). Stages 0.03 + 0.1 + 1.25 s."""
    text = BLOCKS["kitti06"].make(kept, kept.parents[1])
    head, first, second, *paper = rows_of(text)
    by_heading = dict(zip(head, first, strict=True))
    assert by_heading["SETTINGS"] == "`system=bgs_slam`"
    assert [by_heading[name] for name in ("PSNR dB", "SSIM", "LPIPS")] == [
        "22.00 ± 1.41",
        "0.800 ± 0.000",
        "0.125 ± 0.000",
    ]
    assert (by_heading["held-out dB"], by_heading["held-out SSIM"]) == ("20.00 ± 1.41", "0.700 ± 0.000")
    assert (by_heading["right dB"], by_heading["right SSIM"]) == ("", ""), "not scored"
    assert (by_heading["Depth-L1 cm"], by_heading["Gaussians k"]) == ("150 ± 0", "253 ± 0")
    assert (by_heading["stages s"], by_heading["wall s"]) == ("1.38 ± 0.00", "2.00 ± 0.00")
    assert second[:4] == ["`system=bgs_slam stereo=lidar`", "16.00", "0.800", "0.125"]
    assert second[head.index("ATE m")] == "0.250"
    # The paper's table: 23.57 dB, 0.87, 0.15, 226.89 cm, 0.90 m, 16.77 GB on sequence 06, 0.24 + 1.37 s per frame.
    assert paper[0] == [
        *("*paper, BGS-SLAM, sequence 06*", "*23.57*", "*0.87*", "*0.15*", "", "", "", "", "*227*", "*0.90*", ""),
        *("*16.77*", "*1.61*", ""),
    ]
    assert paper[1][:4] == ["*paper, BGS-SLAM (LiDAR), sequence 06*", "*10.47*", "*0.47*", "*0.66*"]
    assert paper[1][head.index("Depth-L1 cm")] == "*303*"
    assert re.search(
        r"\*3 runs; seeds 0, 1; protocol paper; .*\[record\]\(results/tables/kitti06\.runs\.json\)\*", text
    )


def test_trackers_are_compared_by_medians(kept: Path) -> None:
    """Medians by pandas: of 0.2 0.1 0.9 and of 0.4 0.8 0.5."""
    ours, theirs = pd.Series([0.2, 0.1, 0.9]).median(), pd.Series([0.4, 0.8, 0.5]).median()
    rows = {row[0]: row[1:] for row in rows_of(BLOCKS["trackers"].make(kept, kept))}
    assert rows["ATE, m"] == [f"{ours:.3f}", f"{theirs:.3f}", f"{ours / theirs:.2f}"]
    assert rows["RPE, RMSE, mm"] == ["40.0", "100.0", "0.40"]


def test_circuits_name_the_loops_of_the_log(kept: Path) -> None:
    text = BLOCKS["circuits"].make(kept, kept)
    assert rows_of(text)[1:] == [
        [str(seed), f"{seed / 10:.3f}", f"{420 + seed} → {seed}, {420 + seed} → {seed}", "10", "0"]
        for seed in (1, 2, 10)
    ]
    assert "Mean ATE 0.433 m. " in text
    assert "code 0123456 with changes; AMD, 2 cores, no GPU" in text


def test_events_are_read_and_words_are_not(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("loop closed: frame 8 sees the place of frame 6 (9 inliers)\n")
    assert read_provenance(tmp_path) == {}
    (tmp_path / "events.jsonl").write_text(
        '{"kind": "loop_closed", "frame": 7, "values": {"to_frame": 5}}\n{"kind": "lost", "frame": 9, "values": {}}\n'
    )
    assert read_provenance(tmp_path) == {"loops_closed": [[7, 5]]}
    (tmp_path / "events.jsonl").write_text('{"kind": "loop_cl')
    with pytest.raises(BenchError, match=r"events\.jsonl is damaged"):
        read_provenance(tmp_path)


def test_stereo_and_performance_come_from_their_own_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "results" / "tables"
    kept.mkdir(parents=True)
    columns = (
        "stereo,epe_px,d1_percent,density_percent,ms_per_frame,psnr_db,heldout_psnr_db,lpips,depth_l1_cm,s_per_frame"
    )
    (kept / "stereo_kitti06.csv").write_text(f"{columns}\nsgbm,1.274,4.82,90.1,79.4,23.4,21.7,0.2279,175.6,0.772\n"
                                             "lidar,,,,,22.1,,0.23,211,0.85\n")  # fmt: skip
    rows = rows_of(BLOCKS["stereo"].make(kept, tmp_path))
    assert rows[1] == ["`sgbm`", "1.27", "4.8", "90", "79", "23.40", "21.70", "0.228", "176", "0.77"]
    assert rows[2] == ["`lidar`", "", "", "", "", "22.10", "", "0.230", "211", "0.85"]
    benchmarks = tmp_path / "performance"
    benchmarks.mkdir()
    for name, text in (("losses", "normal: torch / core"), ("ssim", "conv2d / fused")):
        (benchmarks / f"{name}.json").write_text(json.dumps({"ratios": {text: 40.95}}))
    file = tmp_path / "R.md"
    file.write_text("<!-- table: performance -->\n<!-- end -->\n")
    assert doc_tables([str(file), "--kept", str(kept), "--performance", str(benchmarks)]) == 2
    assert "performance.json lacks the ratio 'forward + backward, isotropic 100 k / mm' of rasterizer" in (
        capsys.readouterr().err
    )
    content = json.loads((kept / "performance.json").read_text())
    assert content["benchmarks"]["ssim"] == {"ratios": {"conv2d / fused": 40.95}}
    assert set(content["device"]) == {"cpu", "usable_cores", "gpu"}


def sample_of_a_gpu() -> dict[str, Any]:
    stages = {"render": 2.0, "losses": 1.0, "backward": 4.0, "adam": 1.0}
    step = {"step_ms": 8.0, "stages_ms": stages, "gpu_memory_gb": 1.25, "mm_gpu_ms": 0.0512, "mm_cpu_ms": 4.02}
    errors = {name: [0.0, 2e-6, 1e-3, 1e-2] for name in ("color", "depth", "alpha")} | {"means": [0.0, 3e-4, 1.0, 2.0]}
    rows = [{"gaussians": 100_000, **step, "step_ms": 2.56}, {"gaussians": 1_000_000, **step}]
    runs = [
        {"system": "bgs_slam_fast", "rasterizer": "gsplat", "frames_per_s": 6.54, "psnr_db": 24.567},
        {"system": "bgs_slam_fast", "rasterizer": "cpu", "frames_per_s": 1.0, "psnr_db": 24.5},
    ]
    return {
        "format": 1,
        "device": {
            **{"gpu": "NVIDIA X", "driver": "580.1", "cuda": "13.0", "torch": "2.11", "gsplat": "1.5.3"},
            "date": "2026-11-30",
        },
        "parts": {
            "kernels": {"status": "done", "seconds": 100.0, "result": {"alpha": 0.5}},
            "conformance": {"status": "done", "seconds": 9.0, "result": {"errors": {"a": {"cpu": errors}}}},
            "mapping_step": {
                "status": "out of time",
                "seconds": 90.0,
                "result": {"rows": [*rows, {"gaussians": 5_000_000, "reason": "out of memory"}]},
            },
            "whole_system": {"status": "failed", "seconds": 90.0, "reason": "...", "result": {"rows": runs}},
            "marked_tests": {"status": "left out", "seconds": 0.0, "reason": "..."},
        },
    }


def test_gpus_have_a_row_each_once_they_were_measured(tmp_path: Path) -> None:
    kept = tmp_path / "results" / "tables"
    assert BLOCKS["gpu"].make(kept, tmp_path) == "", "no table before the first file"
    (kept.parent / "gpu").mkdir(parents=True)
    file = kept.parent / "gpu" / "nvidia-x.json"
    write_json(file, sample_of_a_gpu())
    (row,) = rows_of(BLOCKS["gpu"].make(kept, tmp_path))[1:]
    assert row == [
        "[NVIDIA X](results/gpu/nvidia-x.json), driver 580.1, CUDA 13.0, torch 2.11, gsplat 1.5.3; 2026-11-30",
        *("2.6 / 8.0 / -", "25 / 12 / 50 / 12", "1.2 / 1.2 / -", "6.54 / -", "24.57 / -", "2.0e-06 / 3.0e-04", "-"),
        "0.05 / 4.0",
    ]
    spoilt = sample_of_a_gpu()
    spoilt["parts"]["mapping_step"]["result"]["rows"][0].pop("step_ms")
    write_json(file, spoilt)
    with pytest.raises(BenchError, match=r"nvidia-x\.json is damaged \(KeyError\('step_ms'\)\)"):
        BLOCKS["gpu"].make(kept, tmp_path)


def test_a_table_of_the_paper_stands_in_the_readme(tmp_path: Path) -> None:
    for seed in (0, 1, 2):
        make_run(tmp_path / "runs" / str(seed), config("03", seed=seed), metrics(801, psnr_db=20.0 + seed))
    kept = tmp_path / "results" / "tables"
    make_table("ablation", [tmp_path / "runs"]).write(kept)
    text = BLOCKS["ablation"].make(kept, tmp_path)
    assert "| Ours (full) | 3 | 21.00 ± 1.00 |" in text
    assert "- Our numbers are by protocol paper." in text
    assert "[ablation.md](results/tables/ablation.md)" in text


def test_the_command_rewrites_and_checks(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = kept.parents[1] / "README.md"
    given = [str(file), "--kept", str(kept)]
    before = "a\n<!-- table: trackers -->\nold\n<!-- end -->\n<!-- table: ablation -->\nkept\n<!-- end -->\n"
    file.write_text(before)
    assert doc_tables([*given, "--check"]) == 1
    assert ", stale: trackers; run `python -m tools.doc_tables`" in capsys.readouterr().out
    assert file.read_text() == before
    assert doc_tables(given) == 0
    assert "left as it is: ablation: there is no " in capsys.readouterr().out
    assert "| ATE, m | 0.200 |" in file.read_text()
    assert file.read_text().endswith("-->\nkept\n<!-- end -->\n")
    assert doc_tables([*given, "--check"]) == 0


def test_runs_of_no_row_and_lacking_numbers_are_named(kept: Path) -> None:
    runs = read_kept(kept / "kitti06.runs.json")
    with pytest.raises(BenchError, match=r"The kept run lidar belongs to none of the rows stereo=sgbm"):
        by_settings(runs, ["stereo=sgbm"])
    assert number(runs[0], "views.none.psnr_db") is None
    assert number(runs[0], "resources.none+resources.wall_s_per_frame") is None
    assert figures("{:.1f}", "views.none.psnr_db")(runs) == ""
