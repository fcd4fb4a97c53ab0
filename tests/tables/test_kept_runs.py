"""Record files: the same tables to the byte without the run folders, and nothing of a machine in them."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from fake_runs import config, make_run, metrics

from bench.cli import main
from bench.errors import BenchError
from bench.io.atomic import write_json
from bench.tables.document.forms import FORMS
from bench.tables.named.find import table_names
from bench.tables.named.records import read_runs
from bench.tables.named.table import make_table
from bench.tables.records.file import SUFFIX, read_record_file, record_text
from bench.tables.records.made import made_in_words
from bench.tables.records.portable import portable_config, portable_text
from bench.tables.records.record import RunRecord
from bench.tables.records.settings import settings_of
from bench.tables.records.shared import in_common, together, without

KEPT = sorted((Path(__file__).parents[2] / "results" / "tables").glob(f"*{SUFFIX}"))
OF_THE_PAPER = [file for file in KEPT if file.name.removesuffix(SUFFIX) in table_names()]


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Runs of several settings, protocols and states, with paths of a machine wherever a run folder may hold some."""
    folder = tmp_path / "secret place" / "runs"
    for seed in (0, 1, 2):
        scores = metrics(801, psnr_db=20.0 + seed / 3, ssim=0.5, ate_rmse_m=1.0, static_camera_ate_rmse_m=169.8)
        scores["views"]["heldout"] = {"n": 8, "psnr_db": 18.0 + seed}
        scores["dialects"] = {
            name: {"n_views": 3, "psnr_db": 30.0 + seed, "stamp": {"zeta": 1, "alpha": 2}} for name in ("zz", "aa")
        }
        made = config("03", seed=seed, dataset__root="/secret/data", dataset__weights="/secret/nets/net v1.onnx")
        make_run(folder / f"r{seed}", made, scores)
        provenance: dict[str, Any] = {
            "git": {"commit": "abc", "dirty": False},
            "command": ["/secret/bin/bgs-bench"],
            "seed": seed,
        }
        provenance |= {
            "platform": "secret",
            "machine": {"cpu": "AMD", "usable_cores": 2, "gpu": None, "mm_ms": 23.4, "host": "secret"},
        }
        write_json(folder / f"r{seed}" / "provenance.json", provenance)
    (folder / "r0" / "events.jsonl").write_text(
        '{"kind": "lost", "frame": 9, "values": {}}\n{"kind": "loop_closed", "frame": 422, "values": {"to_frame": 2}}\n'
    )
    reason = "Can't read '/secret/data/velodyne/3.bin' at 0.5 s/frame"
    make_run(folder / "bad", config("05"), None, state="failed", frames=2, reason=reason)
    other = config("03", protocol__name="default")
    make_run(folder / "other", other, metrics(801, psnr_db=9.0) | {"protocol": {"name": "default"}})
    make_run(folder / "stranger", config("03", losses=("rgb",)), metrics(801, psnr_db=9.0))
    (make_run(folder / "damaged", config("06"), {}) / "metrics.json").write_text("{")
    return folder


@pytest.mark.parametrize("name", table_names())
def test_a_table_comes_back_to_the_byte_without_the_folders(name: str, runs: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "tables", tmp_path / "again"
    written = make_table(name, [runs]).write(first)
    before = {file.name: file.read_bytes() for file in written}
    assert sorted(before) == sorted(f"{name}.{form}" for form in (*FORMS, "runs.json"))
    shutil.rmtree(runs)
    shutil.copytree(first, second)
    again = make_table(name, [second / f"{name}{SUFFIX}"]).write(second)
    assert {file.name: file.read_bytes() for file in again} == before


def test_nothing_of_the_machine_is_kept(runs: Path, tmp_path: Path) -> None:
    for name in table_names():
        for file in make_table(name, [runs]).write(tmp_path / "tables"):
            text = file.read_text()
            assert "secret" not in text, file
            assert str(tmp_path) not in text, file
    kept = read_record_file(tmp_path / "tables" / f"ablation{SUFFIX}")
    (run,) = (run for run in kept.runs if run.name == "r0")
    assert run.config["dataset"] == {"name": "kitti", "sequence": "03", "frames": "", "weights": "net v1.onnx"}
    assert run.provenance["loops_closed"] == [[422, 2]]
    assert run.provenance["machine"] == {"cpu": "AMD", "usable_cores": 2, "gpu": None, "mm_ms": 23.4}
    assert run.provenance["git"] == {"commit": "abc", "dirty": False}
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", run.date)
    bad = read_record_file(tmp_path / "tables" / f"main_kitti{SUFFIX}")
    (failed,) = (run for run in bad.runs if run.name == "bad")
    assert failed.reason == "Can't read '3.bin' at 0.5 s/frame"
    assert bad.problems[0].startswith("damaged/metrics.json is damaged")


def test_a_table_says_when_from_what_and_where_it_was_made(runs: Path) -> None:
    (note,) = (note for note in make_table("ablation", [runs]).notes if note.startswith("Made "))
    assert re.fullmatch(r"Made \d{4}-\d\d-\d\d; code abc; AMD, 2 cores, no GPU, mm 1024\^3 23 ms\.", note)


def test_machines_are_told_with_the_span_of_their_yardstick() -> None:
    cpu = {"cpu": "AMD", "usable_cores": 2, "gpu": None}
    machines = [
        cpu | {"mm_ms": 31.4},
        cpu,
        cpu | {"mm_ms": 22.6},
        {"cpu": "Arm", "mm_ms": "fast"},
        "?",
        cpu | {"cpu": "B"},
    ]
    runs = [RunRecord("r", Path("r"), {}, "done", provenance={"machine": machine}) for machine in machines]
    assert made_in_words(runs) == [
        "AMD, 2 cores, no GPU, mm 1024^3 23 to 31 ms; Arm, None cores, no GPU; B, 2 cores, no GPU"
    ]


def test_one_line_a_run_and_cells_lead_to_it(runs: Path, tmp_path: Path) -> None:
    table = make_table("ablation", [runs])
    table.write(tmp_path)
    lines = (tmp_path / f"ablation{SUFFIX}").read_text().splitlines()
    links = re.findall(r"\[(\d)\]\(<ablation\.runs\.json#L(\d+)>\)", (tmp_path / "ablation.md").read_text())
    assert {seed for seed, _ in links} == {"0", "1", "2"}
    for seed, line in links:
        entry = json.loads(lines[int(line) - 1].rstrip(","))
        assert (entry["config"]["seed"], entry["name"]) == (int(seed), f"r{seed}")
    assert json.loads("\n".join(lines))["others"] == 2, "the stranger and the run of 05 are counted, not kept"


def test_runs_of_one_name_keep_their_order(tmp_path: Path) -> None:
    """Twelve folders "x", alike but for their numbers; as text, line 10 of the record comes before line 9."""
    for number in range(12):
        make_run(tmp_path / str(number) / "x", config("03"), metrics(801, psnr_db=20.0 + (7 * number) % 12))
    first = make_table("ablation", [tmp_path / str(number) / "x" for number in range(12)])
    before = {file.name: file.read_bytes() for file in first.write(tmp_path / "t")}
    again = make_table("ablation", [tmp_path / "t" / f"ablation{SUFFIX}"]).write(tmp_path / "t")
    assert {file.name: file.read_bytes() for file in again} == before
    assert "Ours (full), 03: seed 0 was run 12 times; x is shown." in first.notes


def test_other_protocols_are_left_out_and_said(runs: Path, tmp_path: Path) -> None:
    """Three runs by protocol paper and one by default: the cell shows the three, and the note names what differs."""
    table = make_table("ablation", [runs])
    assert "| Ours (full) | 3 | 20.33 ± 0.33 |" in table.text("md", tmp_path)
    note = "Ours (full), 03: 1 run with other settings (dataset.weights, protocol.name) not shown"
    assert any(text.startswith(note) for text in table.notes)
    assert "Our numbers are by protocol paper." in table.notes
    alone = make_table("ablation", [runs / "other"])
    assert "| Ours (full) | 1 | 9.00 |" in alone.text("md", tmp_path)
    assert "All our numbers are by protocol default, not paper." in alone.notes
    make_run(runs / "w", config("03", losses=("rgb", "ssim", "geo", "smooth")), metrics(801, psnr_db=21.0))
    both = make_table("ablation", [runs / "other", runs / "w"])
    assert "By protocol default, not paper: Ours (full) 03." in both.notes


def test_a_run_scored_again_under_another_protocol_counts_as_that(tmp_path: Path) -> None:
    """`bgs-bench evaluate` changes the stamp in metrics.json, not the config of the run."""
    make_run(tmp_path / "a", config("03"), metrics(801, psnr_db=20.0))
    scores = metrics(801, psnr_db=30.0) | {"protocol": {"name": "default", "alignment": "se3"}}
    make_run(tmp_path / "b", config("03", seed=1), scores)
    text = make_table("ablation", [tmp_path]).text("md", tmp_path)
    assert "| Ours (full) | 1 | 20.00 |" in text
    assert "25.00" not in text


def test_views_of_a_record_are_kept_and_can_be_changed(runs: Path, tmp_path: Path) -> None:
    make_table("ablation", [runs], "heldout").write(tmp_path)
    record = tmp_path / f"ablation{SUFFIX}"
    assert "| Ours (full) | 3 | 19.00 ± 1.00 |" in make_table("ablation", [record]).text("md", tmp_path)
    assert "| Ours (full) | 3 | 20.33 ± 0.33 |" in make_table("ablation", [record], "left").text("md", tmp_path)


def test_the_table_of_runs_reads_records_too(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (runs / "damaged" / "metrics.json").unlink()
    record = tmp_path / f"mine{SUFFIX}"
    assert main(["table", str(runs), "--out", str(record), str(tmp_path / "a.csv")]) == 0
    assert main(["table", str(record), "--out", str(tmp_path / "b.csv"), str(tmp_path / f"again{SUFFIX}")]) == 0
    in_order = sorted((tmp_path / "a.csv").read_text().splitlines())
    assert sorted((tmp_path / "b.csv").read_text().splitlines()) == in_order
    assert (tmp_path / f"again{SUFFIX}").read_bytes() == record.read_bytes()
    assert main(["table", "ablation", str(record), "--format", "md"]) == 0
    assert "| Ours (full) | 3 | 20.33 ± 0.33 |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"Can't read .*x\.runs\.json"),
        ("{", r"x\.runs\.json is damaged \(line 1"),
        ("{}", r"x\.runs\.json is no record of runs"),
        ('{"format": "bgs-bench runs 1"}', r"x\.runs\.json is damaged: KeyError: 'views'\. Restore it"),
    ],
)
def test_damaged_records_are_named(content: str | None, message: str, tmp_path: Path) -> None:
    record = tmp_path / f"x{SUFFIX}"
    if content is not None:
        record.write_text(content)
    with pytest.raises(BenchError, match=message):
        make_table("ablation", [record])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/data/kitti", "kitti"),
        ("Can't open /a/b/c.png: no such file", "Can't open c.png: no such file"),
        ("'/a b/c' of 1.5 s/frame", "'a b/c' of 1.5 s/frame"),
        ("see https://example.org/a/b, </b> and 1 / 2", "see https://example.org/a/b, </b> and 1 / 2"),
        ("relative/path.txt and ../up/x", "relative/path.txt and ../up/x"),
    ],
)
def test_absolute_paths_lose_all_but_their_last_part(text: str, expected: str) -> None:
    assert portable_text(text) == expected


def test_settings_that_are_paths() -> None:
    made = {
        "dataset": {"root": "/r", "left": "/a b/left *.png", "frames": "0:10"},
        "output": "/o",
        "stereo": {"l": ["/x/y", 2]},
    }
    assert portable_config(made) == {"dataset": {"left": "left *.png", "frames": "0:10"}, "stereo": {"l": ["y", 2]}}


def test_infinite_settings_come_back_from_a_record_as_from_the_folder(tmp_path: Path) -> None:
    infinite = config("06", mapper__max_depth_m=math.inf, tracker__range_m=[0.0, math.inf])
    found = read_runs([make_run(tmp_path / "run", infinite, metrics(1101))])
    (file := tmp_path / f"kept{SUFFIX}").write_text(record_text(found))
    json.loads(file.read_text(), parse_constant=pytest.fail)
    folder, record = (settings_of(read.runs[0].config) for read in (found, read_record_file(file)))
    assert folder == record
    assert folder["mapper.max_depth_m"] == "inf"


MANY: list[list[dict[str, Any]]] = [
    [{"a": 1, "b": {"c": [1], "d": {}}}, {"a": 1, "b": {"c": [1], "d": {"e": 2}}}],
    [{"a": 1}, {"a": 1.0}, {"a": True}],
    [{"a": {}}, {"a": {"b": 1}}, {}],
    [{"a": {"b": 1}}, {"a": {"b": 1, "c": 2}}],
    [{"a": None}, {"a": None}],
    [{"only": {"one": 1}}],
]


@pytest.mark.parametrize("several", MANY)
def test_what_is_shared_and_the_rest_make_the_whole_again(several: list[dict[str, Any]]) -> None:
    common = in_common(several)
    for one in several:
        again = together(common, without(one, common))
        assert json.dumps(again, sort_keys=True) == json.dumps(one, sort_keys=True)


def test_what_is_shared_is_kept_once() -> None:
    assert in_common(MANY[0]) == {"a": 1, "b": {"c": [1]}}
    assert without(MANY[0][1], {"a": 1, "b": {"c": [1]}}) == {"b": {"d": {"e": 2}}}


@pytest.mark.parametrize("record", OF_THE_PAPER or [None], ids=lambda file: file.name if file else "none")
def test_kept_tables_are_those_of_their_records(record: Path | None, tmp_path: Path) -> None:
    """What lies in results/tables, to the byte; `bgs-bench table NAME FILE.runs.json --out results/tables` mends it."""
    if record is None:
        pytest.skip("no table of the paper is kept yet")
    name = record.name.removesuffix(SUFFIX)
    shutil.copy(record, tmp_path)
    for file in make_table(name, [tmp_path / record.name]).write(tmp_path):
        mend = f"run `bgs-bench table {name} results/tables/{record.name} --out results/tables`"
        assert file.read_bytes() == (record.parent / file.name).read_bytes(), f"{file.name} is stale: {mend}"


@pytest.mark.parametrize("record", KEPT or [None], ids=lambda file: file.name if file else "none")
def test_kept_records_hold_no_path_of_a_machine(record: Path | None) -> None:
    if record is None:
        pytest.skip("no record is kept yet")
    assert not re.search(r'"(/|~/|[A-Z]:\\\\)[^"]', record.read_text())
    assert read_record_file(record).runs
