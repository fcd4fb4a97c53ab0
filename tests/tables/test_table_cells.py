"""Which run belongs to which cell: by what Hydra makes of the overrides that define the cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from bench.config import compose_run
from bench.errors import BenchError
from bench.runs.config_file import NO_PART_OF_THE_RUN, write_config
from bench.tables.named.definitions import MethodRow, cells
from bench.tables.named.find import named_table, table_files
from bench.tables.named.overrides import belongs, holds, row_of
from bench.tables.records.folder import read_folder
from bench.tables.records.settings import settings_of


def test_cells_of_the_ablation() -> None:
    ablation = cells(named_table("ablation"))
    assert [cell.column for cell in ablation] == ["03"] * 7
    by_row = {cell.row.split(" (")[0]: cell.overrides for cell in ablation}
    assert "sky=none" in by_row["w/o ss"]
    assert "loss=[rgb,ssim,normal,smooth]" in by_row["w/o wd"]
    assert "loss.geo.stride=1" in by_row["with ds"]
    assert "loss.geo.edge_weighted=false" in by_row["w/o gradient weight"]
    for cell in ablation:
        assert cell.overrides[:2] == ("dataset=kitti", "dataset.sequence=03")


def test_cells_are_scored_as_the_paper_does_unless_the_user_says_otherwise() -> None:
    for name in table_files():
        cell = cells(named_table(name))[0]
        own = {"unseen": "heldout", "small_motion": "default"}.get(name, "paper")
        assert {f"protocol={own}", "seed=1"} <= set(cell.overrides_with(["seed=1"]))
        chosen = cell.overrides_with(["protocol=heldout", "protocol.sky=in"])
        assert [each for each in chosen if each.startswith("protocol")] == ["protocol=heldout", "protocol.sky=in"]
    cell = cells(named_table("ablation"))[0]
    common = ["dataset.root=/nowhere"]
    assert compose_run(cell.overrides_with(common)).protocol.name == "paper"
    assert compose_run(cell.overrides_with([*common, "protocol=heldout"])).protocol.name == "heldout"
    assert compose_run(cell.overrides_with([*common, "protocol.holdout_every=5"])).protocol.holdout_every == 5


def test_rows_on_part_of_a_sequence_are_so_unless_the_user_chooses_frames() -> None:
    row = MethodRow("slow", ("system=bgs_slam",), on_part=True)
    table = replace(named_table("main_kitti"), rows=(row,), part=("dataset.frames=0:300",))
    cell = cells(table)[0]
    assert "dataset.frames=0:300" in cell.overrides_with(["dataset.root=/data"])
    assert [each for each in cell.overrides_with(["dataset.frames=0:10"]) if "frames" in each] == [
        "dataset.frames=0:10"
    ]
    assert not cells(replace(table, part=()))[0].part


def test_withheld_cells_say_so() -> None:
    blocked = {cell.column for cell in cells(named_table("main_kitti360")) if cell.blocked}
    assert blocked == {"0008"}
    assert not any(cell.blocked for cell in cells(named_table("main_kitti")))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["main_kitti", "ablation", "backbones", "baselines", "mixed", "readings"])
def test_what_hydra_composes_belongs_to_its_own_row_alone(name: str) -> None:
    table = named_table(name)
    sequence, chosen = next(iter(table.sequences.items()))
    for row in table.rows:
        if row.overrides is None:
            continue
        composed = compose_run(["dataset=kitti", *chosen, "dataset.root=/nowhere", *row.overrides]).values
        assert row_of(table, composed) == (row.label, sequence)
        flat = settings_of(composed)
        assert {key: flat[key] for key in (each.split("=")[0] for each in row.iterations)} == dict(
            each.split("=") for each in row.iterations
        ), "the iterations that the method has"
        assert [other.label for other in table.rows if belongs(other, composed)] == [row.label]
        # An ablation on other data is no cell of this table.
        assert row_of(table, composed | {"dataset": {"name": "street", "sequence": "03"}}) is None
        assert row_of(table, composed | {"dataset": {"name": "kitti", "sequence": "00"}}) is None


def test_a_run_folders_config_reads_as_it_was_composed(tmp_path: Path) -> None:
    """The fast reader against Hydra's own data, with values that YAML could take for something else."""
    composed = compose_run(
        ["dataset=kitti", "dataset.root=/a b", "dataset.sequence='07'", "dataset.frames='10:20'", "seed=2"]
    ).values
    write_config(tmp_path, composed, "abc")
    read = read_folder(tmp_path).config
    # Where the run and its data lay, and how it was started, is no part of the record.
    assert set(composed) - set(read) == set(NO_PART_OF_THE_RUN)
    del composed["dataset"]["root"]
    assert read == {key: value for key, value in composed.items() if key in read}
    assert read["dataset"]["frames"] == "10:20"


def test_the_reader_survives_odd_text(tmp_path: Path) -> None:
    odd = {
        "system": "a: b # c",
        "seed": 1,
        "evaluator": ["x", "y"],
        "dataset": {"name": "line\none\n\ntwo"},
        "loss": {},
    }
    write_config(tmp_path, odd, "abc")
    assert read_folder(tmp_path).config == odd
    (tmp_path / "config.yaml").write_text("# bgs-bench run, config hash abc\nsystem: [a\nseed: 1\n")
    with pytest.raises(BenchError, match=r"config\.yaml can't be read: .* Delete the run folder"):
        read_folder(tmp_path)


def test_overrides_hold_or_not() -> None:
    config = {
        "dataset": {"name": "kitti", "sequence": "03"},
        "loss": {"rgb": {"weight": 0.8}, "geo": {"stride": 2, "edge_weighted": False}},
        "system": "bgs_slam",
        "tracker": {"name": "splatam", "iterations": 3},
    }
    assert holds(config, "tracker=splatam_tum"), "a preset whose settings were changed"
    true = ("dataset=kitti", "dataset.sequence=3", "loss=[geo,rgb]", "loss.geo.stride=2", "loss.rgb.weight=0.80")
    for override in (*true, "loss.geo.edge_weighted=false", "system=bgs_slam"):
        assert holds(config, override), override
    false = ("dataset=street", "dataset.sequence=06", "loss=[rgb]", "loss=[rgb,geo,ssim]", "loss.geo.stride=1")
    for override in (*false, "loss.geo.edge_weighted=true", "loss.normal.weight=1", "stereo=sgbm", "system=bgs"):
        assert not holds(config, override), override


def test_unknown_tables_are_named() -> None:
    with pytest.raises(BenchError, match=r"table='main_kiti' is not one of ablation, .* Did you mean 'main_kitti'\?"):
        named_table("main_kiti")
    assert sorted(table_files()) == [
        "ablation",
        "backbones",
        "baselines",
        "main_kitti",
        "main_kitti360",
        "memory",
        "mixed",
        "readings",
        "runtime",
        "small_motion",
        "unseen",
    ]
