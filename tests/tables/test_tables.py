"""Tables of finished, failed, half-written and damaged runs."""

from __future__ import annotations

import argparse
import csv
import io
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from bench.commands import list as list_command
from bench.commands import table as table_command
from bench.errors import BenchError
from bench.runs.folder import RunFolder
from bench.tables.collect import Row, collect_row, find_runs
from bench.tables.document.forms import text_of
from bench.tables.render import print_table, runs_document
from bench.tables.static_camera import static_camera_rows

CONFIG: dict[str, Any] = {
    "dataset": {"name": "kitti", "sequence": "06"},
    "system": "bgs_slam",
    "stereo": {"name": "sgbm"},
    "tracker": {"name": "stereo_orb"},
}
METRICS: dict[str, Any] = {
    "protocol": {"name": "heldout", "alignment": "se3", "depth_max_m": None},
    "trajectory": {"ate_rmse_m": 0.12345},
    "views": {
        "left": {"n": 10, "psnr_db": 23.456, "ssim": 0.8123, "lpips": None, "depth_l1_cm": 187.65},
        "heldout": {"n": 2, "psnr_db": 21.5},
        "right": {"n": 10, "psnr_db": 21.75},
    },
    "resources": {
        "peak_memory_gb": 1.234,
        "tracking_s_per_frame": 0.1,
        "stereo_s_per_frame": 0.05,
        "mapping_s_per_frame": 2.5,
    },
    "map": {"gaussians": 123456},
    "notes": {"lpips": "no AlexNet weights"},
}


def make_run(path: Path, state: str, metrics: dict[str, Any] | None, reason: str = "") -> Path:
    folder = RunFolder.create(path, CONFIG, "h", rerun=False)
    folder.set_status(state, reason, 10 if state == "done" else 3, 10)
    if metrics is not None:
        folder.write_json("metrics.json", metrics)
    return path


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """One folder with a finished run, one out of memory, one damaged, one that only began."""
    make_run(tmp_path / "a_done", "done", METRICS)
    make_run(tmp_path / "b_oom", "out_of_memory", None, "asked for 40 GB")
    make_run(tmp_path / "c_damaged", "done", METRICS)
    (tmp_path / "c_damaged" / "metrics.json").write_text('{"views": {')
    RunFolder.create(tmp_path / "d_begun", CONFIG, "h", rerun=False)
    (tmp_path / "not_a_run").mkdir()
    return tmp_path


def written(form: str, rows: list[Row]) -> str:
    return text_of(runs_document(rows), form, Path())


def cells(markdown: str, run: str) -> dict[str, str]:
    markdown = markdown.replace("\\_", "_")
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in markdown.splitlines() if line[:1] == "|"]
    return next(dict(zip(lines[0], line, strict=True)) for line in lines[2:] if line[0] == run)


def test_a_finished_run_has_its_numbers_rounded(runs: Path) -> None:
    row = cells(written("md", [collect_row(runs / "a_done")]), "a_done")
    assert row["Dataset"] == "kitti/06"
    assert (row["System"], row["Stereo"], row["Tracker"], row["Status"]) == ("bgs_slam", "sgbm", "stereo_orb", "done")
    assert (row["ATE [m]"], row["PSNR [dB]"], row["SSIM"], row["LPIPS"]) == ("0.123", "23.46", "0.812", "-")
    assert (row["Depth-L1 [cm]"], row["Held-out PSNR [dB]"], row["Right PSNR [dB]"]) == ("187.7", "21.50", "21.75")
    assert (row["Gaussians"], row["Memory [GB]"], row["Time [s/frame]"]) == ("123,456", "1.23", "2.65")
    assert row["Frames"] == "10/10"


def test_failed_and_damaged_runs_have_a_row_that_says_so(runs: Path) -> None:
    rows = [collect_row(folder) for folder in find_runs([runs])]
    text = written("md", rows)
    assert [row.values["run"] for row in rows] == ["a_done", "b_oom", "c_damaged", "d_begun"]
    assert cells(text, "b_oom")["Status"] == "out of memory"
    assert cells(text, "b_oom")["Frames"] == "3/10"
    assert cells(text, "c_damaged")["Status"] == "done (damaged)"
    assert cells(text, "c_damaged")["PSNR [dB]"] == "-"
    assert cells(text, "d_begun")["Status"] == "no status"
    assert "metrics.json is damaged (line 1" in text
    assert "- b\\_oom: stopped: asked for 40 GB" in text


def with_frames(static_m: float, lost: int = 0, total: int = 10, **trajectory: float) -> dict[str, Any]:
    """The metrics above with a static camera's error and tracking states; frames 4, 5, ... were lost."""
    frames = {"total": total, "tracked": total - lost, "ok": total - lost, "weak": 0, "lost": lost}
    frames["lost_stretches"] = [[4, 3 + lost]] if lost else []  # type: ignore[assignment]
    known = METRICS["trajectory"] | {"static_camera_ate_rmse_m": static_m} | trajectory
    return METRICS | {"trajectory": known, "frames": frames}


def test_lost_frames_are_in_the_status_and_below_the_table(tmp_path: Path) -> None:
    metrics = with_frames(92.16, lost=3, static_camera_compared_ate_rmse_m=15.25)
    text = written("md", [collect_row(make_run(tmp_path / "a", "done", metrics))])
    assert cells(text, "a")["Status"] == "done, 3 frames lost"
    assert cells(text, "a")["Frames"] == "7/10"
    assert "- a: 3 frames lost (4 to 6); on the others a static camera's ATE is 15.250 m" in text


def test_a_run_that_was_never_scored_hides_no_lost_frames(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "a", CONFIG, "h", rerun=False)
    states = ["ok", "lost", "lost", "weak"]
    rows = [{"number": i, "timestamp": i, "state": s, "mapped": 0, "heldout": 0} for i, s in enumerate(states)]
    folder.write_frames(rows)
    folder.set_status("failed", "no more", 4, 9)
    row = collect_row(tmp_path / "a")
    assert (row.values["status"], row.values["frames"]) == ("failed, 2 frames lost", "2/9")
    assert "2 frames lost (1 to 2)" in row.notes


def test_one_static_camera_a_data_set_however_many_runs(tmp_path: Path) -> None:
    """Runs a and b have the same frames (b lost some, and used the other camera), c is shorter, d has no truth."""
    made = {"a": with_frames(92.16), "b": with_frames(92.18, lost=2), "c": with_frames(31.5, total=5), "d": METRICS}
    rows = [collect_row(make_run(tmp_path / name, "done", metrics)) for name, metrics in made.items()]
    references = static_camera_rows(rows)
    assert [(r.values["dataset"], r.values["frames"], r.values["ate_rmse_m"]) for r in references] == [
        ("kitti/06", "10/10", 92.16),
        ("kitti/06", "5/5", 31.5),
    ]
    text = written("md", rows)
    assert cells(text, "static camera")["ATE [m]"] == "*92.160*"
    assert cells(text, "static camera")["PSNR [dB]"] == "-"
    assert [line.split("|")[1].strip() for line in text.splitlines()[2:8]] == [
        *("a", "b", "c", "d", "static camera", "static camera")
    ]
    latex = written("tex", rows)
    body = latex.partition(r"\midrule")[2]
    assert body.count(r"static camera & \textit{kitti/06}") == 2
    assert r"\midrule" in body.partition("static camera")[0], "a rule above the reference rows"
    table = list(csv.DictReader(written("csv", rows).splitlines()))
    assert [(row["run"], row["ate_rmse_m"]) for row in table[4:]] == [
        ("static camera", "92.16"),
        ("static camera", "31.5"),
    ]


def test_the_terminal_shows_the_static_camera_too(tmp_path: Path) -> None:
    rows = [collect_row(make_run(tmp_path / name, "done", with_frames(92.16))) for name in "ab"]
    for shown_rows, expected in ((rows, 1), (rows[:1], 1)):
        console = Console(file=io.StringIO(), width=300)
        print_table(shown_rows, console)
        lines = [line for line in console.file.getvalue().splitlines() if "static camera" in line]  # type: ignore
        assert len(lines) == expected
        assert "92.160" in lines[0]


def test_columns_that_no_run_fills_are_left_out(tmp_path: Path) -> None:
    plain = collect_row(make_run(tmp_path / "plain", "done", METRICS))
    assert "RPE" not in written("md", [plain])
    assert "rpe_trans_rmse_m" in written("csv", [plain])
    drift = with_frames(92.16, rpe_trans_rmse_m=0.01234, t_rel_short_percent=1.2345)
    text = written("md", [plain, collect_row(make_run(tmp_path / "drift", "done", drift))])
    assert (cells(text, "drift")["RPE [m]"], cells(text, "drift")["t_rel 10-50 m [%]"]) == ("0.0123", "1.23")
    assert cells(text, "plain")["RPE [m]"] == "-"
    assert "t_rel [%]" not in text, "short segments are no standard ones"


def test_odd_values_do_not_stop_the_table(tmp_path: Path) -> None:
    odd = {"views": [], "trajectory": {"ate_rmse_m": "far"}, "resources": {"mapping_s_per_frame": "slow"}, "notes": 3}
    row = collect_row(make_run(tmp_path / "odd", "done", odd))
    assert row.values["s_per_frame"] is None
    assert "odd" in written("md", [row])


def test_a_runs_text_stays_text_in_every_form(tmp_path: Path) -> None:
    name, reason = """=1+1|<script>'"x""", '<script>hurt(1)</script> | "q"'
    rows = [collect_row(make_run(tmp_path / name, "failed", None, reason))]
    for form in ("html", "md"):
        assert "<script" not in written(form, rows)
        assert "&lt;script>" in written(form, rows).replace("&gt;", ">")
    (run,) = csv.DictReader(io.StringIO(written("csv", rows)))
    assert run["run"] == f"'{name}"
    # The bar of the name parts no columns.
    head, _, line = written("md", rows).splitlines()[:3]
    assert line.replace(r"\|", "").count("|") == head.count("|")
    assert r"=1+1$|$$<$script$>$" in written("tex", rows)


def test_the_protocol_and_the_notes_stand_below_the_table(runs: Path) -> None:
    text = written("md", [collect_row(runs / "a_done")])
    assert "- Protocol: name heldout, alignment se3, depth\\_max\\_m none." in text
    assert "- a\\_done: lpips: no AlexNet weights" in text


def test_latex_has_booktabs_rules_and_escapes_names(runs: Path) -> None:
    text = written("tex", [collect_row(runs / "a_done")])
    assert r"a\_done & kitti/06 & bgs\_slam" in text
    for rule in (r"\toprule", r"\midrule", r"\bottomrule", r"\end{tabular}"):
        assert rule in text
    body = [line for line in text.splitlines() if line.endswith(r"\\")]
    columns = text.partition(r"\begin{tabular}{")[2].partition("}")[0]
    assert {line.count(" & ") + 1 for line in body} == {len(columns)}
    assert "-" in body[2].split(" & "), "a value that is not known is a dash"


def test_the_command_writes_every_form(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = [tmp_path / "tables" / f"all{suffix}" for suffix in (".md", ".csv", ".tex", ".html")]
    parser = argparse.ArgumentParser()
    table_command.add_parser(parser.add_subparsers())
    arguments = parser.parse_args(["table", str(runs), "--out", *map(str, out)])
    assert arguments.run(arguments) == 0
    with open(out[1], newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["psnr_db"] == "23.456"
    assert rows[0]["lpips"] == ""
    assert rows[1]["status"] == "out of memory"
    assert out[0].read_text().startswith("| Run |")
    printed = capsys.readouterr().out
    for name in ("a_done", "b_oom", "c_damaged", "d_begun"):
        assert sum(name in line and "kitti/06" in line for line in printed.splitlines()) == 1
    with pytest.raises(BenchError, match=r"--out x\.pdf: .* one of \.md, \.csv, \.tex, \.html"):
        table_command.run(
            argparse.Namespace(places=[str(runs)], out=[Path("x.pdf")], format=None, plugins=[], columns="both")
        )


def test_folders_without_runs_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BenchError, match="is no run folder and holds none"):
        find_runs([tmp_path])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BenchError, match="There is no folder results/runs"):
        find_runs([])


def test_list_has_one_line_a_plugin_and_the_broken_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    broken: dict[str, str] = {}
    for module in ("bench.registry", "bench.discovery"):
        monkeypatch.setattr(f"{module}.broken_files", broken)
    (tmp_path / "my_net.py").write_text("import a_package_that_is_not_there\n")
    assert list_command.run(argparse.Namespace(kind="evaluator", name=None, plugins=[str(tmp_path)])) == 0
    lines = capsys.readouterr().out.splitlines()
    names = ["ate", "depth_l1", "dialects", "image", "kitti_odometry", "regions", "resources", "rpe"]
    assert [line.split()[1] for line in lines[:8]] == names
    assert all(line.split()[2] == "available" for line in lines[:8])
    assert lines[8].startswith("broken")
    assert "my_net.py: ModuleNotFoundError: No module named 'a_package_that_is_not_there'" in lines[8]
    with pytest.raises(BenchError, match=r"kind='evaluators' is not one of .* Did you mean 'evaluator'\?"):
        list_command.run(argparse.Namespace(kind="evaluators", name=None, plugins=[]))
