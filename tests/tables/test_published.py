"""The published numbers against the paper's own averages, its text and its bold print, and the ground truth."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.installed_data import published_folder
from bench.tables.named.find import named_table, table_files
from bench.tables.named.published import PublishedValue, read_sequences
from bench.tables.named.published import read_published as read_values

TABLES = {name: table for name in table_files() if (table := named_table(name)).published}
KITTI = ("03", "05", "06", "07", "09", "10")


def read_published(table: str) -> list[PublishedValue]:
    return read_values(published_folder() / f"{table}.csv", table)


def read_references(table: str) -> list[PublishedValue]:
    return [value for file in TABLES[table].references for value in read_values(file, table)]


def value_of(table: str, method: str, metric: str, sequence: str) -> float:
    found = [
        v.number
        for v in read_published(table)
        if (v.method, v.metric, v.sequence) == (method, metric, sequence) and v.number is not None
    ]
    assert len(found) == 1, f"{table}, {method}, {metric}, {sequence}: {found}"
    return found[0]


def by_line(values: list[PublishedValue]) -> dict[tuple[str, str], dict[str, PublishedValue]]:
    lines: dict[tuple[str, str], dict[str, PublishedValue]] = defaultdict(dict)
    for value in values:
        assert value.sequence not in lines[value.method, value.metric], f"{value} is there twice"
        lines[value.method, value.metric][value.sequence] = value
    return lines


@pytest.mark.parametrize("table", ["main_kitti", "main_kitti360"])
def test_the_papers_averages_follow_from_its_rows_or_a_note_says_so(table: str) -> None:
    lines = by_line(read_published(table))
    assert len(lines) == 25, "five methods, five metrics"
    differing = []
    for (method, metric), line in lines.items():
        average = line.pop("average")
        assert sorted(line) == sorted(TABLES[table].sequences)
        mean = np.mean([float(value.value) for value in line.values()])
        # The paper rounds to 0.01; a mean that ends in 5 may go either way.
        follows = abs(mean - float(average.value)) < 0.0051
        assert follows == (average.note == ""), f"{method}, {metric}: {mean} and {average.value}, {average.note!r}"
        if not follows:
            assert f"{mean:.3f}" in average.note
            differing.append((method, metric))
    assert differing == ([("SplaTAM", "depth_l1_cm")] if table == "main_kitti" else [])


def test_the_papers_text_agrees() -> None:
    """Differences that the paper's sentences state, and columns that occur in two of its tables."""
    full, no_sky, no_depth = (
        {metric: value_of("ablation", row, metric, "03") for metric in ("psnr_db", "depth_l1_cm")}
        for row in ("Ours", "w/o ss", "w/o wd")
    )
    assert full["psnr_db"] - no_sky["psnr_db"] == pytest.approx(0.63)
    assert no_depth["depth_l1_cm"] - full["depth_l1_cm"] == pytest.approx(148.26)
    for metric in ("psnr_db", "ssim", "lpips", "depth_l1_cm"):
        main = value_of("main_kitti", "BGS-SLAM (Ours)", metric, "03")
        assert main == value_of("ablation", "Ours", metric, "03") == value_of("backbones", "MonSter-M", metric, "03")
    for table, gain in (("main_kitti", 6.0), ("main_kitti360", 10.0)):
        ours = value_of(table, "BGS-SLAM (Ours)", "psnr_db", "average")
        rivals = [value_of(table, name, "psnr_db", "average") for name in ("Point-SLAM", "SplaTAM", "MonoGS")]
        assert ours - max(rivals) > gain
        for sequence in TABLES[table].sequences:
            # One tracker serves both variants.
            assert value_of(table, "BGS-SLAM (Ours)", "ate_rmse_m", sequence) == value_of(
                table, "BGS-SLAM (LiDAR)", "ate_rmse_m", sequence
            )
    assert value_of("backbones", "IGEV", "depth_l1_cm", "03") == 278.20
    assert value_of("backbones", "TCSM", "depth_l1_cm", "03") == 300.29
    assert value_of("runtime", "BGS-SLAM (Ours)", "tracking_s_per_frame", "average") == 0.24
    assert value_of("runtime", "BGS-SLAM (Ours)", "mapping_s_per_frame", "average") == 1.37


# PSNR, SSIM, LPIPS and Depth-L1 as the paper prints them, typed a second time.
SMALL_TABLES = {
    "ablation": """
        w/o ss           24.19 0.92 0.11 141.71
        w/o wd           23.86 0.91 0.12 284.36
        w/o nl           24.25 0.92 0.11 193.20
        w/o sl           23.82 0.91 0.12 186.46
        with ds          21.17 0.84 0.22 263.68
        Ours             24.82 0.93 0.10 136.10""",
    "backbones": """
        IGEV             23.34 0.90 0.14 278.20
        IGEV++           23.19 0.89 0.15 293.57
        TCSM             23.16 0.89 0.15 300.29
        MonSter-K        23.33 0.90 0.15 186.32
        Mocha            24.17 0.91 0.12 462.00
        FoundationStereo 24.57 0.92 0.11 132.65
        MonSter-M        24.82 0.93 0.10 136.10""",
}


@pytest.mark.parametrize("table", SMALL_TABLES)
def test_small_tables_digit_by_digit(table: str) -> None:
    printed = [line.strip() for line in SMALL_TABLES[table].splitlines() if line.strip()]
    lines = by_line(read_published(table))
    methods = list(dict.fromkeys(method for method, _ in lines))
    metrics = ("psnr_db", "ssim", "lpips", "depth_l1_cm")
    ours = [" ".join([f"{m:<16}", *(lines[m, metric]["03"].value for metric in metrics)]) for m in methods]
    assert ours == printed


# What the paper prints in bold other than all of "BGS-SLAM (Ours)" (and both variants' ATE), and what of ours it does
# not: read off its tables.
BOLD_ELSEWHERE = {
    "main_kitti": [("Point-SLAM", "depth_l1_cm", "09")],
    "main_kitti360": [("BGS-SLAM (LiDAR)", "depth_l1_cm", "0002"), ("BGS-SLAM (LiDAR)", "depth_l1_cm", "0007")],
}


@pytest.mark.parametrize("table", ["main_kitti", "main_kitti360"])
def test_what_is_best_is_what_the_paper_prints_in_bold(table: str) -> None:
    expected = {(metric, sequence): method for method, metric, sequence in BOLD_ELSEWHERE[table]}
    columns: dict[tuple[str, str], dict[str, float]] = defaultdict(dict)
    for value in read_published(table):
        columns[value.metric, value.sequence][value.method] = float(value.value)
    for (metric, sequence), column in columns.items():
        best = (max if metric in ("psnr_db", "ssim") else min)(column.values())
        winners = [method for method, number in column.items() if number == best]
        if metric == "ate_rmse_m":
            assert winners == ["BGS-SLAM (LiDAR)", "BGS-SLAM (Ours)"]
        else:
            assert winners == [expected.get((metric, sequence), "BGS-SLAM (Ours)")], f"{metric} {sequence}"


def test_daggers_crosses_and_unknowns() -> None:
    baselines = {"Point-SLAM", "SplaTAM", "MonoGS"}
    for table in ("main_kitti", "main_kitti360"):
        assert {value.method for value in read_published(table) if value.status == "dagger"} == baselines
    memory = by_line(read_published("memory"))
    assert {value.status for value in memory["SplaTAM", "peak_memory_gb"].values()} == {"cross"}
    ours = [memory["BGS-SLAM (Ours)", "peak_memory_gb"][sequence].value for sequence in KITTI]
    assert ours == ["8.08", "45.12", "16.77", "14.81", "20.36", "20.62"]
    assert [v.metric for v in read_published("runtime") if v.status == "not reported"] == ["stereo_s_per_frame"]
    withheld = {name: facts.withheld for name, facts in read_sequences("kitti360").items() if facts.withheld}
    assert list(withheld) == ["0008"]


def test_every_row_of_a_table_names_published_numbers() -> None:
    for table in TABLES.values():
        values = read_published(table.name)
        methods = {value.method for value in values}
        rows = [row.published for row in table.rows if row.published]
        assert sorted(rows) == sorted(methods), f"{table.name}: each method of the paper has its row"
        assert {row.compared_with for row in table.rows} - {""} <= methods
        assert {(value.table, value.dataset) for value in values} == {(table.name, table.dataset)}
        assert {value.metric for value in values} <= {metric.key for metric in table.metrics}
        assert all(value.source for value in [*values, *read_references(table.name)])


def test_the_static_camera_is_that_of_the_ground_truth(test_data: Path) -> None:
    """RMS distance of the positions to their mean, straight from KITTI's files, in float64."""
    lines = by_line(read_references("main_kitti"))
    frames = {name: facts.frames for name, facts in read_sequences("kitti").items()}
    for method, count in (("static camera, first 300 frames", 300), ("static camera", None)):
        line = lines[method, "ate_rmse_m"]
        for sequence in KITTI:
            rows = np.loadtxt(test_data / f"kitti_odometry/poses/{sequence}.txt")
            assert len(rows) == frames[sequence]
            centres = rows.reshape(-1, 3, 4)[:count, :, 3]
            rms = np.sqrt(((centres - centres.mean(axis=0)) ** 2).sum(axis=1).mean())
            assert float(line[sequence].value) == pytest.approx(rms, abs=0.005)
        mean = np.mean([float(line[sequence].value) for sequence in KITTI])
        assert float(line["average"].value) == pytest.approx(mean, abs=0.0101)


# Column t_abs of Table I in arXiv 1610.06475, sequences 00 to 10, typed a second time.
ORB_SLAM2_T_ABS = (1.3, 10.4, 5.7, 0.6, 0.2, 0.8, 0.8, 0.5, 3.6, 3.2, 1.0)


def test_orb_slam2s_row_is_that_of_its_paper() -> None:
    line = by_line(read_references("main_kitti"))["ORB-SLAM2 (stereo)", "ate_rmse_m"]
    values = {sequence: float(line[sequence].value) for sequence in KITTI}
    assert values == {sequence: ORB_SLAM2_T_ABS[int(sequence)] for sequence in KITTI}
    assert float(line["average"].value) == pytest.approx(np.mean(list(values.values())))


def test_the_files_hold_nothing_else() -> None:
    """Every CSV file is read by a table, so that none is forgotten."""
    names = {path.stem for path in published_folder().glob("*.csv")}
    assert names == {*TABLES, "references", "sequences"}
    with open(published_folder() / "references.csv", newline="") as file:
        assert {row["table"] for row in csv.DictReader(file)} <= set(TABLES)


GOOD = "table,dataset,sequence,method,metric,value,unit,status,note,source\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace(",note", ""), r"t\.csv lacks the column 'note'"),
        (GOOD + "t,kitti,03,A,ssim,0.9x,,ok,,paper\n", r"t\.csv, line 2: '0\.9x' is no number"),
        (GOOD + "t,kitti,03,A,ssim,0.9,,okay,,paper\n", r"t\.csv, line 2: status='okay' is not one of .* Did you mean"),
        (GOOD + "t,kitti,03,A,ssim,0.9,,cross,,paper\n", r"line 2: status 'cross' does not go with the value '0\.9'"),
        (GOOD + "t,kitti,03,A,ssim,,,ok,,paper\n", r"line 2: status 'ok' does not go with the value ''"),
        (GOOD + "t,kitti,03\n", r"t\.csv, line 2 has not 10 values"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(BenchError, match=message):
        read_values(tmp_path / "t.csv", "t")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"t\.csv does not exist"):
        read_values(tmp_path / "t.csv", "t")
