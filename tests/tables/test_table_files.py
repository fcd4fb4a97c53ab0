"""Another paper's table is a file: one YAML and one CSV in a user's folder, in every form, and with clear errors."""

from __future__ import annotations

import csv
import html
import importlib.metadata
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from fake_runs import make_run as write_run
from fake_runs import metrics

from bench import registry
from bench.cli import main
from bench.errors import BenchError
from bench.sweeps.experiment import expand_experiment
from bench.tables.named.find import named_table, table_names
from bench.tables.named.table import make_table

TABLE = """\
title: Depth of <two> streets & more | A_B
about: An invented paper.
dataset: street
sequences: {north_1: dataset.seed=1, south: dataset.seed=2}
metrics: [{key: psnr_db, decimals: 1}, ssim]
seeds: [4]
published: invented.csv
overrides: system=bgs_slam
rows:
  - label: A|B <i>net</i> & co_1
    published: A|B <i>net</i> & co_1
  - label: Ours, sgbm
    compared_with: A|B <i>net</i> & co_1
    overrides: stereo=sgbm
"""
NUMBERS = """\
table,dataset,sequence,method,metric,value,unit,status,note,source
invented,street,north_1,A|B <i>net</i> & co_1,psnr_db,20.5,dB,ok,,"Anon, 2031"
invented,street,south,A|B <i>net</i> & co_1,psnr_db,19.0,dB,ok,a | <b> & c_d,"Anon, 2031"
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "mine"
    (folder / "table").mkdir(parents=True)
    (folder / "table" / "invented.yaml").write_text(TABLE)
    (folder / "table" / "invented.csv").write_text(NUMBERS)
    return folder


def make_run(path: Path, street: int, psnr_db: float) -> None:
    made: dict[str, Any] = {
        "system": "bgs_slam",
        "seed": 4,
        "protocol": {"name": "default"},
        "dataset": {"name": "street", "sequence": "03", "seed": street},
        "stereo": {"name": "sgbm"},
    }
    scores = metrics(801, psnr_db=psnr_db, ssim=0.5) | {"protocol": {"name": "default"}}
    write_run(path, made, scores)


def shown_in(form: str, text: str) -> str:
    """The text as a reader sees it: without what a format needs to show signs that mean something to it."""
    if form == "md":
        return html.unescape(re.sub(r"\\([|_*`\\&])", r"\1", text))
    if form == "html":
        return html.unescape(re.sub(r"<[a-z/][^>]*>", "", text))
    if form == "tex":
        for written, sign in (
            (r"$<$", "<"),
            (r"$>$", ">"),
            (r"$|$", "|"),
            (r"\&", "&"),
            (r"\_", "_"),
            ("$-$", "\u2212"),
        ):
            text = text.replace(written, sign)
    return text


@pytest.mark.parametrize("form", ["md", "csv", "tex", "html"])
def test_a_paper_from_two_files_in_every_form(form: str, mine: Path, tmp_path: Path) -> None:
    """A run of ours with 18.0 dB stands beside the published 20.5 dB: 2.5 less."""
    make_run(tmp_path / "runs" / "a", 1, 18.0)
    text = make_table("invented", [tmp_path / "runs"], folders=[str(mine)]).text(form, tmp_path)
    seen = shown_in(form, text)
    assert "A|B <i>net</i> & co_1" in seen
    assert "20.5" in seen
    assert "18.0" in seen
    if form == "csv":
        (ours,) = [row for row in csv.DictReader(text.splitlines()) if row["value"] == "18.0"]
        assert (ours["method"], ours["sequence"], ours["difference"]) == ("Ours, sgbm", "north_1", "-2.5")
        return
    assert "Depth of <two> streets & more | A_B" in seen
    assert "20.5 (\u22122.5)" in seen
    assert "a | <b> & c_d" in seen
    assert "An invented paper." in seen


def test_columns_stay_whole_whatever_the_names(mine: Path) -> None:
    table = make_table("invented", [], folders=[str(mine)])
    rows = [line for line in table.text("md", Path()).splitlines() if line.startswith("|")]
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {1 + 3 + 3}
    latex = table.text("tex", Path())
    body = latex.partition(r"\toprule")[2].partition(r"\bottomrule")[0]
    assert {len(re.findall(r"(?<!\\)&", line)) for line in body.splitlines() if line.endswith(r"\\")} == {5}
    assert "<i>" not in table.text("html", Path())


def test_the_commands_know_it(mine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_run(tmp_path / "runs" / "a", 2, 19.5)
    assert main(["table", "invented", "--plugins", str(mine), "runs", "--out", "out"]) == 0
    assert "19.5 (1)" in capsys.readouterr().out
    assert sorted(file.suffix for file in (tmp_path / "out").iterdir()) == [".csv", ".html", ".json", ".md", ".tex"]
    again = ["table", "invented", "out/invented.runs.json", "--plugins", str(mine), "--format", "csv"]
    assert main(again) == 0
    assert "19.5" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["table", "--plugins", str(mine), "--help"])
    assert "unseen, invented, dialects; without a name" in " ".join(capsys.readouterr().out.split())
    assert main(["table", "inventd", "--plugins", str(mine)]) == 2
    assert "Did you mean 'invented'?" in capsys.readouterr().err
    assert main(["reproduce", "invented", f"plugins=[{mine}]", "dataset.frames=4", "--dry-run"]) == 0
    planned = capsys.readouterr().out
    assert planned.count("Ours, sgbm, north_1, seed 4") == 1
    assert planned.count("Ours, sgbm, south, seed 4") == 1


def test_an_experiment_of_a_users_table(mine: Path) -> None:
    cells = expand_experiment(["experiment=invented", f"plugins=[{mine}]", "seed=0,1"])
    assert [overrides for _, overrides in cells] == [
        ["protocol=default", f"plugins=[{mine}]", "seed=0,1", "dataset=street", f"dataset.seed={street}",
         "system=bgs_slam", "stereo=sgbm"]
        for street in (1, 2)
    ]  # fmt: skip


def test_a_table_with_nothing_to_run_says_so(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (mine / "table" / "invented.yaml").write_text(TABLE.replace("    overrides: stereo=sgbm\n", ""))
    for command in (["reproduce", "invented"], ["run", "-m", "experiment=invented"]):
        assert main([*command, f"plugins=[{mine}]"]) == 2
        assert "invented.yaml has no row of ours, so there is nothing to run" in capsys.readouterr().err
    assert main(["table", "invented", "--plugins", str(mine), "--format", "md"]) == 0


def test_notes_tell_how_a_rows_runs_differ_from_the_method(mine: Path, tmp_path: Path) -> None:
    """Three of 40 iterations are told, 70 of 60 are not; a note stands below the table where there are runs."""
    of_row = "iterations: tracker.iterations=40 mapper.iterations=60\n    note: In colour, unlike its authors'.\n"
    (mine / "table" / "invented.yaml").write_text(TABLE + f"    {of_row}")
    assert not any("Ours" in note for note in make_table("invented", [], folders=[str(mine)]).notes)
    make_run(tmp_path / "runs" / "a", 1, 18.0)
    file = tmp_path / "runs" / "a" / "config.yaml"
    file.write_text(file.read_text() + "tracker: {name: x, iterations: 3}\nmapper: {name: y, iterations: 70}\n")
    notes = make_table("invented", [tmp_path / "runs"], folders=[str(mine)]).notes
    assert "Ours, sgbm was run with fewer iterations than the method has: tracker.iterations 3 of 40." in notes
    assert "Ours, sgbm: In colour, unlike its authors'." in notes


def test_what_is_known_of_sequences_may_lie_beside_the_table(mine: Path, tmp_path: Path) -> None:
    head = "dataset,sequence,length_km,frames,frames_rounded_to,withheld,source\n"
    (mine / "table" / "sequences.csv").write_text(f"{head}street,north_1,0.4,900,1,,Anon\n")
    make_run(tmp_path / "runs" / "a", 1, 18.0)
    text = make_table("invented", [tmp_path / "runs"], folders=[str(mine)]).text("md", tmp_path)
    assert "north\\_1 (0.4/900) | south | Average" in text
    assert "† 801 of 900 frames of north\\_1" in text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("title:", "titel:", r"invented\.yaml has an unknown key 'titel'; there are title, .* Did you mean 'title'\?"),
        ("title: Depth", "about: x # Depth", r"invented\.yaml lacks 'title'"),
        ("ssim]", "sim]", r"invented\.yaml: a metric: key='sim' is not one of .* Did you mean 'ssim'\?"),
        ("decimals: 1", "decimal: 1", r"a metric has an unknown key 'decimal'; .* Did you mean 'decimals'\?"),
        ("stereo=sgbm", "stero=sgbm", r"row 'Ours, sgbm': overrides: 'stero=sgbm' is no .* Did you mean 'stereo'\?"),
        ("stereo=sgbm", "stereo", r"row 'Ours, sgbm': overrides: 'stereo' sets nothing"),
        ("stereo=sgbm", "dataset=kitti", r"row 'Ours, sgbm': overrides: 'dataset=kitti' is no setting here"),
        ("stereo=sgbm", "[stereo=sgbm]", r"row 'Ours, sgbm': overrides: \['stereo=sgbm'\] is no text"),
        ("    compared_with", "    compare_with", r"row 2 has an unknown key .* Did you mean 'compared_with'\?"),
        ("label: Ours, sgbm", "label: A|B <i>net</i> & co_1", r"two rows are labelled 'A\|B"),
        ("south:", "7:", r"sequences: 7 is no text\. Put it in quotes"),
        ("dataset.seed=1", "stereo=sgbm", r"sequences: north_1: 'stereo=sgbm' is no setting"),
        ("seeds: [4]", "seeds: [4, 4]", r"seeds: \[4, 4\] must be different whole numbers"),
        ("invented.csv", "other.csv", r"published: there is no .*other\.csv\. Put the CSV file there"),
        ("rows:\n", "rows_of: main_kitti\nrows:\n", r"needs either rows, or rows_of"),
        ("rows:\n", "other_rows: stere\nrows:\n", r"other_rows='stere' is not one of stereo, .* Did you mean 'stereo'"),
        ("rows:\n", "other_rows: loss\nrows:\n", r"other_rows='loss' is not one of stereo, sky, tracker"),
        ("metrics:", "columns: metrics\nmetrics:", r"where columns are metrics there is one sequence"),
        ("    overrides", "    on_part: true\n    overrides", r"'Ours, sgbm' is on_part, and the table has no part"),
        ("    overrides", "    on_part: 1\n    overrides", r"row 'Ours, sgbm': on_part: 1 is neither true nor false"),
        ("    overrides", "    iterations: stereo.n=few\n    overrides", r"'stereo\.n=few' is no whole number"),
        ("title:", "title: [", r"invented\.yaml is no YAML: .*line"),
        ("about: An", "about: !!python/object/apply:os.getcwd []\nprotocol: An", r"is no YAML: could not determine"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_place(old: str, new: str, message: str, mine: Path) -> None:
    assert old in TABLE
    (mine / "table" / "invented.yaml").write_text(TABLE.replace(old, new, 1))
    with pytest.raises(BenchError, match=message):
        named_table("invented", [str(mine)])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (",psnr_db,19", ",psnr,19", r"no place in the table: metric='psnr' is not one of psnr_db, ssim\. Did you mean"),
        ("street,south", "street,sout", r"no place in the table: sequence='sout' .* Did you mean 'south'\?"),
        ("north_1,A|B", "north_1,A|C", r"no place in the table: method='A\|C <i>net</i> & co_1' is not one of"),
        ("20.5,dB", "20.5,m", r"unit='m' is not one of dB"),
        ("invented,", "other,", r"invented\.csv has no number of the table invented\. Write invented into its column"),
    ],
)
def test_published_numbers_that_no_cell_would_show_are_named(old: str, new: str, message: str, mine: Path) -> None:
    (mine / "table" / "invented.csv").write_text(NUMBERS.replace(old, new))
    with pytest.raises(BenchError, match=message):
        make_table("invented", [], folders=[str(mine)])


def test_other_rows_of_a_users_table(mine: Path, tmp_path: Path) -> None:
    """A row for each plugin that runs have and no row names, by the settings that all rows share."""
    (mine / "table" / "invented.yaml").write_text(TABLE + "other_rows: stereo\n")
    (mine / "table" / "same_rows.yaml").write_text(
        "title: x\ndataset: street\nsequences: {north_1: dataset.seed=1}\nmetrics: [ssim]\nrows_of: invented\n"
    )
    make_run(tmp_path / "runs" / "a", 1, 18.0)
    file = tmp_path / "runs" / "a" / "config.yaml"
    file.write_text(file.read_text().replace("name: sgbm", "name: own_net"))
    for name in ("invented", "same_rows"):
        assert "own\\_net" in make_table(name, [tmp_path / "runs"], folders=[str(mine)]).text("md", tmp_path)
    file.write_text(file.read_text().replace("system: bgs_slam", "system: bgs_slam_fast"))
    assert "own\\_net" not in make_table("invented", [tmp_path / "runs"], folders=[str(mine)]).text("md", tmp_path)


def test_a_rows_wrong_setting_is_named_when_it_is_composed(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = mine / "table" / "invented.yaml"
    file.write_text(TABLE.replace("stereo=sgbm", "mapper.iteratons=3"))
    assert main(["reproduce", "invented", f"plugins=[{mine}]", "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert f"{file}, row 'Ours, sgbm': mapper.iteratons=3: " in said
    assert "Did you mean 'iterations'?" in said


SHARP = """\
from bench.contracts.evaluator import Evaluator
from bench.contracts.metric import Metric
from bench.registry import PluginConfig, register


@register("evaluator", "sharp", config=PluginConfig)
class Sharp(Evaluator):
    'Sharpness.'

    metrics = (Metric("sharpness_px", "Sharpness", "px", None, None, "extra.sharpness"),)
"""


def test_a_metric_of_a_users_evaluator(mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """1200 px beside 1201 px: whole numbers, none of them the best, as the evaluator does not say what is better."""
    monkeypatch.setattr(registry, "_plugins", dict(registry._plugins))
    (mine / "sharp.py").write_text(SHARP)
    (mine / "table" / "invented.yaml").write_text(TABLE.replace("ssim]", "sharpness_px]"))
    published = "invented,street,north_1,A|B <i>net</i> & co_1,sharpness_px,1201,px,ok,,Anon\n"
    (mine / "table" / "invented.csv").write_text(NUMBERS + published)
    make_run(tmp_path / "runs" / "a", 1, 18.0)
    file = tmp_path / "runs" / "a" / "metrics.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"extra": {"sharpness": 1200}}))
    text = make_table("invented", [tmp_path / "runs"], folders=[str(mine)]).text("md", Path("tables"))
    assert "| Sharpness [px] | ours | 1,200 (1) |" in text
    assert "| 1201 (\u22121) |" in text


def test_a_package_with_plugins_may_bring_tables(mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "a_package_of_tables"
    package.mkdir()
    (package / "__init__.py").touch()
    shutil.copytree(mine / "table", package / "table")
    monkeypatch.syspath_prepend(tmp_path)
    entry = importlib.metadata.EntryPoint("x", "a_package_of_tables.plugins", "bgs_bench.plugins")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry])
    assert named_table("invented").file == package / "table" / "invented.yaml"


def test_names_are_not_taken_twice(mine: Path) -> None:
    assert table_names([str(mine)])[-2:] == ["invented", "dialects"]
    (mine / "table" / "memory.yaml").write_text(TABLE)
    with pytest.raises(BenchError, match=r"memory\.yaml has the same name as .*conf/table/memory\.yaml\. Rename"):
        table_names([str(mine)])
    with pytest.raises(BenchError, match=r"There is no folder .*nowhere"):
        table_names([str(mine / "nowhere")])
