"""Which runs a table wants, in which order, and which overrides can't be."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from fake_bench import TABLE

from bench.config import compose_run
from bench.errors import BenchError
from bench.sweeps.combinations import plan_combinations
from bench.sweeps.experiment import expand_experiment
from bench.sweeps.lookup import look_up
from bench.sweeps.plan import make_plan
from bench.tables.named.definitions import cells
from bench.tables.named.find import named_table
from bench.tables.named.found_rows import choose_rows
from tests.datasets.kitti_disk import write_kitti

THREE_ROWS = f"plugins=[{TABLE}]"
SMALL = ("mapper.iterations=3", "tracker=groundtruth")


@pytest.mark.slow
def test_first_seed_of_every_cell_first_and_short_sequences_before_long_ones(kitti: Path) -> None:
    """06 has 2 frames and 03 has 4; all ten rows of the table have runs of ours, six of them of 300 frames at most."""
    table = named_table("main_kitti")
    table = replace(table, sequences={name: table.sequences[name] for name in ("03", "05", "06")})
    plan = make_plan(table, [f"dataset.root={kitti}"], [1, 0])
    order = [(run.seed, run.cell.column, run.frames) for run in plan.runs]
    assert order == [each for seed in (1, 0) for place in (("06", 2), ("03", 4)) for each in [(seed, *place)] * 10]
    rows = ["Point-SLAM", "SplaTAM", "MonoGS", "BGS-SLAM (LiDAR)", "BGS-SLAM (Ours)", "bgs_slam", "bgs_slam_fast"]
    rows += ["point_slam_outdoor", "splatam_outdoor", "monogs_outdoor"]
    assert [run.cell.row for run in plan.runs[:10]] == rows
    assert {(skipped.cell.row, skipped.cell.column) for skipped in plan.skipped} == {(row, "05") for row in rows}
    assert all("does not exist" in skipped.reason for skipped in plan.skipped)


@pytest.mark.slow
def test_settings_of_one_plugin_hold_for_the_rows_that_use_it(kitti: Path) -> None:
    """And a part of a sequence is what the user says; a setting that no row takes is a mistake."""
    table = named_table("main_kitti")
    rows = tuple(row for row in table.rows if row.label in ("SplaTAM", "bgs_slam"))
    table = replace(table, sequences={"03": table.sequences["03"]}, rows=rows)
    common = [f"dataset.root={kitti}", "tracker.splatam.iterations=3", "mapper.gaussian.iterations=2"]
    splatam, ours = make_plan(table, common, [0]).runs
    assert (splatam.config.values["tracker"]["iterations"], splatam.config.values["mapper"]["iterations"]) == (3, 60)
    assert ours.config.values["mapper"]["iterations"] == 2
    assert make_plan(table, [*common, "dataset.frames=0:1"], [0]).runs[0].frames == 1
    with pytest.raises(
        BenchError, match=r"tracker\.monogs\.iterations=3: no row of main_kitti that can be run has trac"
    ):
        make_plan(table, [*common, "tracker.monogs.iterations=3"], [0])


@pytest.mark.slow
def test_the_run_command_composes_the_very_run(tmp_path: Path) -> None:
    """Otherwise a sweep would look for its runs in folders where they are not; also where the path is an odd one."""
    root = tmp_path / "it's a, {place}"
    write_kitti(tmp_path / "kitti", frames=2, sequence="03")
    quoted = str(root).replace("'", "\\'")
    overrides = [f"dataset.root={tmp_path / 'kitti'}", *SMALL, f"output='{quoted}'"]
    table = named_table("ablation")
    plan = make_plan(replace(table, rows=table.rows[::3]), overrides, [2])
    assert len(plan.runs) == 3
    for planned in plan.runs:
        composed = compose_run(planned.overrides)
        assert (composed.hash, composed.output) == (planned.config.hash, planned.folder)
        assert composed.values["seed"] == 2
        assert planned.folder.parent == root


@pytest.mark.slow
def test_a_setting_that_some_cells_fix_holds_for_the_others(kitti: Path) -> None:
    """Where a row is about that setting, the row's own value stands."""
    table = named_table("main_kitti")
    table = replace(table, sequences={"03": table.sequences["03"]})
    plan = make_plan(table, [f"dataset.root={kitti}", "stereo=sgbm"], [0])
    assert {run.config.values["stereo"]["name"] for run in plan.runs if "LiDAR" in run.cell.row} == {"lidar"}
    assert {run.config.values["stereo"]["name"] for run in plan.runs if "LiDAR" not in run.cell.row} == {"sgbm"}


@pytest.mark.slow
def test_backbones_that_cannot_run_here_are_skipped_with_the_reason(kitti: Path) -> None:
    plan = make_plan(named_table("backbones"), [f"dataset.root={kitti}"], [0])
    assert "SGBM" in {run.cell.row for run in plan.runs}
    assert all(skipped.reason for skipped in plan.skipped)
    assert len(plan.runs) + len(plan.skipped) == 10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "override", "message"),
    [
        ("ablation", "seed=1", "seed=1: a table wants several seeds; give them as --seeds 0,1,2."),
        ("ablation", "mapper.iterations=3,4", "mapper.iterations=3,4 names several values; a table's cells have one."),
        ("ablation", "dataset.sequence=03", "dataset.sequence=03: every cell of ablation has its own dataset.sequence"),
        ("backbones", "stereo=sgbm", "stereo=sgbm: every cell of backbones has its own stereo. Leave it out."),
        ("main_kitti", "sky=none", "a run of 'BGS-SLAM (LiDAR)' would no longer be one of this row of main_kitti"),
        ("ablation", "mapper.iteratons=3", "Did you mean 'iterations'?"),
        ("ablation", "dataset.root=/no/such/place", "No cell of ablation can be run: dataset.root=/no/such/place"),
        (
            "main_kitti360",
            "mapper.iterations=3",
            "holds no folder 'data_2d_raw'. Give the folder that holds KITTI-360's",
        ),
    ],
)
def test_overrides_that_cannot_be(kitti: Path, table: str, override: str, message: str) -> None:
    root = [] if "root" in override else [f"dataset.root={kitti}"]
    with pytest.raises(BenchError) as error:
        make_plan(named_table(table), [*root, override], [0])
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("override", "rows"),
    [
        ("stereo=sgbm", {"SGBM": "stereo=sgbm"}),
        ("stereo=lidar", {"lidar": "stereo=lidar"}),
        ("stereo=lidar,psmnet", {"lidar": "stereo=lidar", "PSMNet": "stereo=psmnet"}),
    ],
)
def test_a_backbone_chooses_its_row(override: str, rows: dict[str, str]) -> None:
    table = named_table("backbones")
    chosen, others = choose_rows(table, ["seed=1", override])
    assert others == ["seed=1"]
    assert {cell.row: cell.overrides[-1] for cell in cells(chosen)} == rows
    assert all("system=bgs_slam_paper" in cell.overrides for cell in cells(chosen))
    assert [cell.row for cell, _ in expand_experiment(["experiment=backbones", override])] == list(rows)
    assert choose_rows(named_table("ablation"), [override]) == (named_table("ablation"), [override])


HERE = {"host": socket.gethostname(), "pid": os.getpid()}
ANOTHER = {"host": "another", "pid": 7}


def ago(seconds: float) -> str:
    return (datetime.now(UTC) - timedelta(seconds=seconds)).isoformat()


DEAD = {"host": socket.gethostname(), "pid": 2**22 + 1}


@pytest.mark.parametrize(
    ("status", "scored", "progress", "reason"),
    [
        ({"state": "done"}, True, "finished", ""),
        ({"state": "done"}, False, "interrupted", "it was not scored"),
        ({"state": "failed", "reason": "no disk"}, False, "failed", "no disk"),
        ({"state": "out_of_memory", "reason": "40 GB"}, True, "failed", "out of memory: 40 GB"),
        ({"state": "interrupted", "reason": "by the user"}, True, "interrupted", "by the user"),
        ({"state": "running", **HERE}, False, "elsewhere", "process OURS"),
        ({"state": "running", **DEAD}, False, "interrupted", "killed"),
        ({"state": "running", **HERE, "host": "another"}, False, "out of sight", "running on another, process"),
        ({"state": "running", **ANOTHER, "updated": ago(60)}, False, "out of sight", "running on another, process"),
        ({"state": "running", **ANOTHER, "updated": ago(7230)}, False, "interrupted", "silent for 1"),
        (None, False, "interrupted", "it has not begun"),
        ({"state": "dancing"}, False, "failed", "names no known state"),
    ],
)
def test_what_a_folder_says(
    tmp_path: Path, status: dict[str, Any] | None, scored: bool, progress: str, reason: str
) -> None:
    assert look_up(tmp_path).progress == "missing"
    (tmp_path / "config.yaml").write_text("# bgs-bench run, config hash 0\nseed: 0\n")
    if status is not None:
        (tmp_path / "status.json").write_text(json.dumps(status))
    if scored:
        (tmp_path / "metrics.json").write_text("{}")
    found = look_up(tmp_path)
    assert found.progress == progress
    reason = reason.replace("OURS", str(os.getpid()))  # not in the parameters: a test has one name in all processes
    assert reason in found.reason if reason else found.reason == ""


def test_an_experiment_is_one_list_of_overrides_a_cell() -> None:
    expanded = expand_experiment(["experiment=ablation", "seed=0,1,2"])
    assert [cell.column for cell, _ in expanded] == ["03"] * 7
    lists = [overrides for _, overrides in expanded]
    start = ["protocol=paper", "seed=0,1,2", "dataset=kitti", "dataset.sequence=03"]
    assert all(each[:4] == start for each in lists)
    assert ["sky=none" in each for each in lists] == [True] + [False] * 6
    assert [overrides for _, overrides in expand_experiment(["seed=0,1"])] == [["seed=0,1"]]
    # Of the six sequences of KITTI-360 the images of one are withheld.
    assert len(expand_experiment(["experiment=main_kitti360"])) == 10 * 5


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["experiment=ablatoin"], "Did you mean 'ablation'?"),
        (["experiment=ablation", "experiment=memory"], "give one experiment at a time"),
    ],
)
def test_experiments_that_cannot_be(overrides: list[str], message: str) -> None:
    with pytest.raises(BenchError) as error:
        expand_experiment(overrides)
    assert message in str(error.value)


@pytest.mark.slow
def test_every_combination_once_in_its_own_folder(tmp_path: Path) -> None:
    """Two values of two keys, one of them twice; the value with a comma and a quote reaches the run as it is."""
    odd = "it's a, {place}"
    quoted = odd.replace("'", "\\'")
    plan = plan_combinations(
        ["seed=0,1,0", "mapper.iterations=3,4", f"cache.folder='{quoted}'", f"output={tmp_path / 'runs'}"]
    )
    settings = [(run.config.values["mapper"]["iterations"], run.seed) for run in plan.runs]
    assert sorted(settings) == [(3, 0), (3, 1), (4, 0), (4, 1)]
    assert plan.runs[0].label == "mapper.iterations=3, seed 0"
    assert plan.root == tmp_path / "runs"
    for planned in plan.runs:
        composed = compose_run(planned.overrides)
        assert (composed.hash, composed.output) == (planned.config.hash, planned.folder)
        assert composed.values["cache"]["folder"] == planned.config.values["cache"]["folder"]
        assert odd in str(composed.values["cache"]["folder"])
        assert planned.folder == plan.root / composed.hash


@pytest.mark.slow
def test_cells_of_an_experiment_are_named_by_row(tmp_path: Path) -> None:
    overrides = ["experiment=three_rows", THREE_ROWS, "mapper.iterations=3,4", "seed=2", f"output={tmp_path}"]
    plan = plan_combinations(overrides)
    assert len(plan.runs) == 6
    assert plan.runs[-1].label == "Ours (full), mapper.iterations=4, 03, seed 2"


@pytest.mark.slow
@pytest.mark.parametrize(("table", "expected"), [("ablation", "cache.all=true"), ("runtime", "cache.enabled=false")])
def test_runs_share_but_where_time_and_memory_are_measured(kitti: Path, table: str, expected: str) -> None:
    whole = named_table(table)
    part = replace(whole, rows=whole.rows[-1:], sequences=dict([*whole.sequences.items()][:1]))
    plan = make_plan(part, [f"dataset.root={kitti}"], [0])
    assert plan.runs
    assert all(planned.overrides[-1] == expected for planned in plan.runs)
    own = make_plan(part, [f"dataset.root={kitti}", "cache.all=false", "cache.enabled=true"], [0])
    assert all(expected not in planned.overrides for planned in own.runs)
