"""The paper's tables from hand-made runs: numbers worked out by hand, marks from status, links, notes and formats."""

from __future__ import annotations

import csv
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from fake_runs import ALL_TERMS, FRAMES, config, make_mixed_runs, make_run, metrics

from bench.cli import main
from bench.errors import BenchError
from bench.tables.named.table import PaperTable, make_table

ABLATION_METRICS = ["PSNR [dB] ↑", "SSIM ↑", "LPIPS ↓", "Depth-L1 [cm] ↓"]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No results/runs of whoever runs the tests."""
    monkeypatch.chdir(tmp_path)


def markdown_rows(text: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        for line in text.splitlines()
        if line.startswith("|") and not line.startswith("|-")
    ]


def line(table: PaperTable, method: str, by: str, metric: str = "") -> dict[str, str]:
    """A line of the Markdown table by column, without links; a sequence's column by its number alone."""
    head, *rows = markdown_rows(table.text("md", Path("tables")))
    columns = [name.split(" (")[0] for name in head]
    current = ["", ""]
    for row in rows:
        current = [row[0] or current[0], (row[1] or current[1]) if len(columns) > 6 and "Metric" in columns else ""]
        if current[0].rstrip("†") == method.replace("_", "\\_") and current[1].startswith(metric):
            found = dict(zip(columns, row, strict=True))
            if "Runs" in found:  # one line a method, the paper's numbers beside ours
                is_ours = by in ("ours", "computed")
                return {
                    name.removesuffix(" paper"): cell for name, cell in found.items() if (" paper" in name) != is_ours
                }
            if found["By"] == by:
                without_paths = {name: re.sub(r"\[(\d+)\]\(<.*?>\)", r"\1", cell) for name, cell in found.items()}
                return {name: re.sub(r"\((\d+): [\d ]+\)", r"(\1)", cell) for name, cell in without_paths.items()}
    raise AssertionError(f"no line {method}, {by}, {metric} in {rows}")


def test_without_runs_the_published_numbers_stand_beside_empty_cells() -> None:
    table = make_table("main_kitti", [])
    assert line(table, "SplaTAM", "paper", "ATE")["10"] == "33.96"
    assert line(table, "BGS-SLAM (Ours)", "paper", "PSNR")["Average"] == "**21.54**"
    assert set(list(line(table, "BGS-SLAM (Ours)", "ours", "PSNR").values())[3:]) == {""}
    assert line(table, "static camera, first 300 frames", "computed", "ATE")["06"] == "*92.16*"
    assert "| SplaTAM† |" in table.text("md", Path())
    assert any("the six values average 396.562" in note for note in table.notes)
    head = markdown_rows(make_table("ablation", []).text("md", Path()))[0]
    assert head == ["Method", "Runs", *(name for metric in ABLATION_METRICS for name in (metric, f"{metric} paper"))]


def test_withheld_images_are_said_in_the_cell_and_below() -> None:
    table = make_table("main_kitti360", [])
    assert line(table, "BGS-SLAM (Ours)", "ours", "ATE")["0008"] == "withheld"
    assert line(table, "BGS-SLAM (Ours)", "paper", "ATE")["0008"] == "**5.55**"
    assert line(table, "static camera, frames of our runs", "computed", "ATE")["0008"] == "*withheld*"
    assert any(note.startswith("0008: the perspective images") for note in table.notes)


def test_seeds_become_mean_spread_and_difference(tmp_path: Path) -> None:
    """23.0, 24.0, 25.0 dB: mean 24, sample deviation 1; the paper has 24.82 on 03."""
    for seed, psnr in enumerate((23.0, 24.0, 25.0)):
        make_run(tmp_path / f"r{seed}", config("03", seed=seed), metrics(801, psnr_db=psnr, ssim=0.5, ate_rmse_m=2.0))
    table = make_table("main_kitti", [tmp_path])
    ours = line(table, "BGS-SLAM (Ours)", "ours", "PSNR")
    assert ours["03"] == "24.00 ± 1.00 (3)"
    assert (ours["05"], ours["Average"]) == ("", "")
    assert line(table, "BGS-SLAM (Ours)", "paper", "PSNR")["03"] == "**24.82 (\u22120.82)**"
    assert line(table, "BGS-SLAM (Ours)", "ours", "ATE")["03"] == "2.000 ± 0.000 (3)"
    assert line(table, "BGS-SLAM (Ours)", "paper", "ATE")["03"] == "**1.77 (+0.23)**"
    assert line(table, "BGS-SLAM (Ours)", "ours", "LPIPS")["03"] == "-", "none of the runs has it"
    rows = list(csv.DictReader(table.text("csv", tmp_path / "out").splitlines()))
    (row,) = [r for r in rows if (r["by"], r["method"], r["sequence"]) == ("ours", "BGS-SLAM (Ours)", "03")][1:2]
    assert (row["metric"], row["value"], row["std"], row["n"], row["seeds"]) == ("psnr_db", "24.0", "1.0", "3", "0 1 2")
    assert (row["runs"], row["status"], row["frames"]) == ("../r0 ../r1 ../r2", "ok", "801")
    assert float(row["difference"]) == pytest.approx(-0.82)


def test_an_average_needs_all_sequences_and_its_spread_is_that_of_the_seeds(tmp_path: Path) -> None:
    """Seed 0: 1..6, seed 1: each 1 more. Averages 3.5 and 4.5, so 4.0 with deviation 1/sqrt(2)."""
    for number, sequence in enumerate(FRAMES):
        for seed in (0, 1):
            scores = metrics(FRAMES[sequence], ate_rmse_m=1.0 + number + seed)
            make_run(tmp_path / f"{sequence}_{seed}", config(sequence, "bgs_slam", seed), scores)
    table = make_table("main_kitti", [tmp_path])
    assert line(table, "bgs_slam", "ours", "ATE")["Average"] == "4.000 ± 0.707 (2)"
    assert line(table, "bgs_slam", "vs. paper", "ATE")["Average"] == "2.26 (+1.74)"
    (tmp_path / "10_1" / "metrics.json").unlink()
    table = make_table("main_kitti", [tmp_path])
    assert line(table, "bgs_slam", "ours", "ATE")["Average"] == "3.917 (1)", "mean of 1.5 2.5 3.5 4.5 5.5 and 6"
    (tmp_path / "10_0" / "metrics.json").unlink()
    assert line(make_table("main_kitti", [tmp_path]), "bgs_slam", "ours", "ATE")["Average"] == ""


def test_best_of_ours_is_bold_and_what_looks_equal_is_equally_good(tmp_path: Path) -> None:
    for system, psnr, ssim in (("bgs_slam", 24.001, 0.9), ("bgs_slam_fast", 23.999, 0.8), ("bgs_slam_paper", 20, 0.1)):
        made = config("05", system, losses=ALL_TERMS if system == "bgs_slam_paper" else ("rgb", "ssim", "geo"))
        make_run(tmp_path / system, made, metrics(2761, psnr_db=psnr, ssim=ssim))
    table = make_table("main_kitti", [tmp_path])
    shown = {
        method: [line(table, method, "ours", metric)["05"] for metric in ("PSNR", "SSIM")]
        for method in ("bgs_slam", "bgs_slam_fast", "BGS-SLAM (Ours)")
    }
    assert shown == {
        "bgs_slam": ["**24.00** (1)", "**0.900** (1)"],
        "bgs_slam_fast": ["**24.00** (1)", "0.800 (1)"],
        "BGS-SLAM (Ours)": ["20.00 (1)", "0.100 (1)"],
    }


def test_dagger_and_cross_come_from_the_status(tmp_path: Path) -> None:
    """Out of memory: scored on its first 300 frames in 03, never scored in 05. Ten frames of 06 are a part too."""
    oom = {"state": "out_of_memory", "reason": "48 GB asked"}
    part = metrics(801, ate_rmse_m=5.0, peak_memory_gb=47.0)
    make_run(tmp_path / "a", config("03"), part, frames=300, **oom)
    make_run(tmp_path / "b", config("05"), None, frames=120, **oom)
    few = metrics(10, ate_rmse_m=0.1, peak_memory_gb=1.0)
    make_run(tmp_path / "c", config("06", dataset__frames="0:10"), few, frames=10)
    make_run(tmp_path / "d", config("07"), None, state="failed", frames=3, reason="no GPU")
    main_table = make_table("main_kitti", [tmp_path])
    ours = line(main_table, "BGS-SLAM (Ours)", "ours", "ATE")
    assert ours["03"] == "5.000 (1)†"
    assert ours["05"].startswith("\u00d7")
    assert ours["06"] == "0.100 (1)†"
    assert ours["07"].startswith("failed")
    notes = "\n".join(main_table.notes)
    assert "† 300 of 801 frames of 03: BGS-SLAM (Ours)." in notes
    assert "† 10 of 1101 frames of 06: BGS-SLAM (Ours)." in notes
    assert "BGS-SLAM (Ours), 05: seed 0: out of memory (48 GB asked)." in notes
    assert "BGS-SLAM (Ours), 03: seed 0: out of memory after 300 frames (48 GB asked)." in notes
    assert "BGS-SLAM (Ours), 07: seed 0: failed (no GPU)." in notes
    memory = line(make_table("memory", [tmp_path]), "BGS-SLAM (Ours)", "ours", "Memory")
    assert memory["03"].startswith("\u00d7"), "what it had used when it stopped is no measurement"
    assert memory["06"] == "1.00 (1)†"
    rows = list(csv.DictReader(main_table.text("csv", tmp_path).splitlines()))
    states = {r["sequence"]: r["status"] for r in rows if r["by"] == "ours" and r["metric"] == "ate_rmse_m"}
    assert [states[s] for s in ("03", "05", "06", "07", "09")] == ["", "", "", "", ""], "bgs_slam_fast has no runs"
    of_paper = {
        r["sequence"]: r["status"]
        for r in rows
        if (r["by"], r["method"], r["metric"]) == ("ours", "BGS-SLAM (Ours)", "ate_rmse_m")
    }
    assert [of_paper[s] for s in ("03", "05", "06", "07", "09")] == ["dagger", "cross", "dagger", "failed", ""]


def test_seeds_that_stopped_early_do_not_enter_the_mean(tmp_path: Path) -> None:
    make_run(tmp_path / "a", config("06", seed=0), metrics(1101, psnr_db=20.0))
    make_run(tmp_path / "b", config("06", seed=1), metrics(1101, psnr_db=22.0))
    make_run(tmp_path / "c", config("06", seed=2), metrics(1101, psnr_db=99.0), state="interrupted", frames=50)
    make_run(tmp_path / "d", config("06", seed=0), metrics(1101, psnr_db=88.0))
    table = make_table("main_kitti", [tmp_path])
    assert line(table, "BGS-SLAM (Ours)", "ours", "PSNR")["06"] == "21.00 ± 1.41 (2)"
    assert "BGS-SLAM (Ours), 06: seed 2 left out: interrupted after 50 frames." in table.notes
    assert "BGS-SLAM (Ours), 06: seed 0 was run 2 times; a is shown." in table.notes


def test_ablation_runs_find_their_rows(tmp_path: Path) -> None:
    """PSNR 1..7 dB by row; also a run that differs in a setting which no row varies."""
    made = {
        "w/o ss (no sky segmentation)": config("03", sky="none"),
        "w/o wd (no geometric loss)": config("03", losses=("rgb", "ssim", "normal", "smooth")),
        "w/o nl (no normal loss)": config("03", losses=("rgb", "ssim", "geo", "smooth")),
        "w/o sl (no smoothness loss)": config("03", losses=("rgb", "ssim", "geo", "normal")),
        "with ds (every pixel supervised)": config("03", loss__geo__stride=1),
        "w/o gradient weight": config("03", loss__geo__edge_weighted=False),
        "Ours (full)": config("03"),
    }
    for number, one in enumerate(made.values(), start=1):
        make_run(tmp_path / str(number), one, metrics(801, psnr_db=float(number)))
    make_run(tmp_path / "other", config("03", losses=("rgb",)), metrics(801, psnr_db=50.0))
    make_run(tmp_path / "street", config("03", dataset__name="street"), metrics(801, psnr_db=50.0))
    table = make_table("ablation", [tmp_path])
    ours = [line(table, method, "ours") for method in made]
    assert [each["PSNR [dB] ↑"] for each in ours] == [f"{number}.00" for number in range(1, 7)] + ["**7.00**"]
    assert {each["Runs"] for each in ours} == {"1"}
    assert line(table, "w/o nl (no normal loss)", "paper")["PSNR [dB] ↑"] == "24.25 (\u221221.25)"
    assert line(table, "w/o gradient weight", "paper")["PSNR [dB] ↑"] == "(\u221218.82)", "minus the paper's Ours"
    assert "minus its Ours)" in table.notes[0]
    assert "1 run belongs to no cell of this table." in table.notes
    assert not any(note.startswith("Settings that differ") for note in table.notes)
    make_run(tmp_path / "8", config("03", sky="none", seed=1, mapper__iterations=10), metrics(801, psnr_db=60.0))
    (tmp_path / "1" / "metrics.json").unlink()
    table = make_table("ablation", [tmp_path])
    assert "Settings that differ between cells that are compared: mapper.iterations (10, 60)." in table.notes


def test_settings_with_more_frames_are_shown_and_the_others_named(tmp_path: Path) -> None:
    """A short trial with many seeds does not take the place of whole runs."""
    for seed in range(4):
        trial = config("06", seed=seed, dataset__frames="0:10", mapper__iterations=5)
        make_run(tmp_path / f"trial{seed}", trial, metrics(10, psnr_db=30.0), frames=10)
    make_run(tmp_path / "whole", config("06"), metrics(1101, psnr_db=21.0))
    table = make_table("main_kitti", [tmp_path])
    assert line(table, "BGS-SLAM (Ours)", "ours", "PSNR")["06"] == "21.00 (1)"
    note = "4 runs with other settings (dataset.frames, mapper.iterations) not shown; name run folders to choose"
    assert f"BGS-SLAM (Ours), 06: {note}." in table.notes
    trials = sorted(tmp_path.glob("trial*"))
    assert line(make_table("main_kitti", trials), "BGS-SLAM (Ours)", "ours", "PSNR")["06"] == "30.00 ± 0.00 (4)†"


def test_the_static_camera_of_our_runs(tmp_path: Path) -> None:
    scores = metrics(1101, ate_rmse_m=1.0, static_camera_ate_rmse_m=137.7251)
    make_run(tmp_path / "a", config("06"), scores)
    table = make_table("main_kitti", [tmp_path])
    assert line(table, "static camera, frames of our runs", "computed", "ATE")["06"] == "*137.725*"
    assert line(table, "static camera", "computed", "ATE")["06"] == "*137.73*"


def test_views_that_mapping_never_saw(tmp_path: Path) -> None:
    scores = metrics(1101, psnr_db=25.0)
    scores["views"]["heldout"] = {"n": 10, "psnr_db": 20.0}
    make_run(tmp_path / "a", config("06"), scores)
    table = make_table("main_kitti", [tmp_path], "heldout")
    assert line(table, "BGS-SLAM (Ours)", "ours", "PSNR")["06"] == "20.00 (1)"
    assert "left views that mapping never saw" in table.notes[0]
    with pytest.raises(BenchError, match=r"--views='unseen' is not one of left, heldout, right"):
        make_table("main_kitti", [tmp_path], "unseen")


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    return make_mixed_runs(tmp_path / "my runs_&%")


def test_links_lead_to_the_runs(mixed: Path, tmp_path: Path) -> None:
    table = make_table("main_kitti", [mixed])
    folder = tmp_path / "tables" / "deep"
    folder.mkdir(parents=True)
    in_markdown = re.findall(r"\[([\d:]+)\]\(<(.+?)>\)", table.text("md", folder))
    in_html = [(seed, link) for link, seed in re.findall(r'<a href="(.+?)">([\d:]+)</a>', table.text("html", folder))]
    in_html = [(seed, link.replace("&amp;", "&")) for seed, link in in_html]
    assert in_markdown == in_html
    targets = {(seed, (folder / unquote(link)).resolve()) for seed, link in in_markdown}
    assert targets == {("03:0", mixed / "a_0"), ("03:1", mixed / "a_1"), ("05:0", mixed / "b"), ("06:0", mixed / "c")}


class Balanced(HTMLParser):
    """Counts the cells of each row, those that reach into it from above too; fails on a tag that closes another."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[int] = []
        self.reaching: list[int] = []
        self.outside: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.outside += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag == "meta":
            return
        self.open.append(tag)
        if tag == "tr":
            self.reaching = [rows - 1 for rows in self.reaching if rows > 1]
            self.rows.append(len(self.reaching))
        elif tag in ("td", "th"):
            self.rows[-1] += 1
            self.reaching += [int(value or 1) for name, value in attrs if name == "rowspan"]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.parametrize("name", ["main_kitti", "ablation", "runtime"])
def test_html_and_markdown_are_sound(name: str, mixed: Path) -> None:
    table = make_table(name, [mixed])
    parser = Balanced()
    page = table.text("html", Path())
    parser.feed(page)
    assert parser.open == []
    assert len(set(parser.rows)) == 1
    assert len({len(row) for row in markdown_rows(table.text("md", Path()))}) == 1
    if name == "main_kitti":
        assert "a &lt; b | 50 % &amp; $x_1^2 {~}\\" in page
        assert "a < b | 50 % & $x_1^2 {~}\\" in parser.text
    # Nothing is loaded from anywhere: all links are to runs.
    assert all(not re.match(r"[a-z]+:|//", link) for link in parser.outside)
    assert "url(" not in page
    assert "@import" not in page


@pytest.mark.parametrize("form", ["md", "csv", "tex", "html"])
def test_the_same_runs_give_the_same_bytes(form: str, mixed: Path) -> None:
    folders = sorted(mixed.iterdir())
    first = make_table("main_kitti", [mixed]).text(form, Path("x"))
    assert first == make_table("main_kitti", folders[::-1]).text(form, Path("x"))
    assert first == make_table("main_kitti", [*folders, mixed]).text(form, Path("x"))


def test_damaged_runs_are_named_and_the_others_shown(mixed: Path) -> None:
    (mixed / "c" / "metrics.json").write_text("{")
    (mixed / "b" / "config.yaml").write_text("")
    table = make_table("main_kitti", [mixed])
    assert line(table, "bgs_slam", "ours", "PSNR")["03"] == "20.50 ± 0.71 (2)"
    assert sum(note.startswith("Not read: ") and "metrics.json is damaged" in note for note in table.notes) == 1
    assert sum(note.startswith("Not read: ") and "config.yaml holds no settings" in note for note in table.notes) == 1


def test_the_command_writes_a_folder_of_formats(
    mixed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["table", "main_kitti", str(mixed), "--out", str(tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        f"main_kitti.{suffix}" for suffix in ("csv", "html", "md", "runs.json", "tex")
    ]
    printed = capsys.readouterr().out
    assert "PSNR [dB]" in printed
    assert "20.50 ± 0.71 (2)" in printed
    assert main(["table", "ablation", "--format", "csv"]) == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert sum(row["by"] == "paper" for row in rows) == 24
    assert main(["table", "memory", "--format", "tex", "--out", str(tmp_path / "out"), str(tmp_path / "m.md")]) == 0
    assert (tmp_path / "out" / "memory.tex").is_file()
    assert (tmp_path / "m.md").is_file()
    assert not (tmp_path / "out" / "memory.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["main_kiti"], "There is no folder and no table main_kiti; the tables are ablation, .* Did you mean"),
        (["ablation", "nowhere"], "There is no folder nowhere"),
        (["ablation", "--out", "table.pdf"], r"--out table\.pdf: .* must be one of \.md, \.csv, \.tex"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["table", *arguments]) == 2
    said = capsys.readouterr().err
    assert re.search(message, said)
    assert said.count("\n") == 1


def test_a_users_backbone_has_a_row_below_the_papers(tmp_path: Path) -> None:
    """20 and 22 dB: mean 21, deviation sqrt(2). Runs of another system, or without a sky, have no row."""
    for seed, psnr in enumerate((20.0, 22.0)):
        own = config("03", seed=seed, stereo="my_net")
        make_run(tmp_path / "runs" / f"own{seed}", own, metrics(801, psnr_db=psnr))
    make_run(tmp_path / "runs" / "sgbm", config("03", stereo="sgbm"), metrics(801, psnr_db=25.0))
    make_run(tmp_path / "runs" / "a_net", config("03", stereo="a_net"), None, state="failed", frames=0)
    make_run(tmp_path / "runs" / "fast", config("03", "bgs_slam_fast", stereo="c_net"), metrics(801, psnr_db=9.0))
    make_run(tmp_path / "runs" / "no_sky", config("03", stereo="b_net", sky="none"), metrics(801, psnr_db=9.0))
    table = make_table("backbones", [tmp_path / "runs"])
    text = table.text("md", tmp_path)
    rows = [row[0] for row in markdown_rows(text)[1:] if row[0]]
    assert rows[-4:] == ["AnyNet", "SGBM", "a\\_net", "my\\_net"]
    assert line(table, "my_net", "ours")["PSNR [dB] ↑"] == "21.00 ± 1.41"
    assert line(table, "SGBM", "ours")["PSNR [dB] ↑"] == "**25.00**"
    assert "2 runs belong to no cell of this table." in table.notes
    assert table.left_out == (
        "In no cell: fast: all rows have system=bgs_slam_paper.",
        "In no cell: no_sky: no row has sky=none.",
    )
    own = next(row for row in csv.DictReader(table.text("csv", tmp_path).splitlines()) if row["method"] == "my_net")
    assert (own["metric"], own["value"], own["paper"]) == ("psnr_db", "21.0", "")
    table.write(tmp_path / "kept")
    again = make_table("backbones", [tmp_path / "kept" / "backbones.runs.json"])
    assert again.text("tex", tmp_path) == table.text("tex", tmp_path)
