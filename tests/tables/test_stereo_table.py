"""Backbones' scores become rows, and runs stand beside the backbone that they used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.evaluation.disparity import score_disparity
from bench.evaluation.stereo_backbone import TRUE_DISPARITY, BackboneScore, ImageScore
from bench.evaluation.stereo_process import Broken
from bench.runs.folder import RunFolder
from bench.tables.document.forms import text_of
from bench.tables.render import runs_document
from bench.tables.stereo import IMAGE_COLUMNS, STEREO_COLUMNS, Scored, image_table, stereo_rows


def row_of(*values: float) -> np.ndarray:
    return np.array([values], np.float32)


def a_score() -> BackboneScore:
    """Two images: errors 3.5 of 10 (an outlier) in one pixel, none in three; 100, 30 and 20 ms."""
    truth = row_of(10, 20, 30)
    images = (
        ImageScore(1, score_disparity(row_of(13.5), row_of(10)), 100.0),
        ImageScore(2, score_disparity(truth, truth), 20.0),
        ImageScore(3, score_disparity(row_of(np.nan), row_of(np.nan)), 30.0),
    )
    return BackboneScore("toy", TRUE_DISPARITY, images, 1.5)


def scored(label: str, outcome: BackboneScore | Broken | None = None, **settings: Any) -> Scored:
    return Scored(label, "toy", {"name": label.partition(" ")[0], **settings}, outcome or a_score())


def make_run(path: Path, stereo: dict[str, Any], psnr_db: float, lpips: float | None = None) -> Path:
    config = {"dataset": {"name": "kitti", "sequence": "06"}, "system": "bgs_slam", "stereo": stereo}
    folder = RunFolder.create(path, config, "h", rerun=False)
    folder.set_status("done", "", 5, 5)
    left = {"psnr_db": psnr_db, "lpips": lpips, "depth_l1_cm": 10 * psnr_db}
    seconds = {"tracking_s_per_frame": 0.1, "stereo_s_per_frame": 0.2, "mapping_s_per_frame": 0.3}
    folder.write_json("metrics.json", {"views": {"left": left}, "resources": seconds})
    return path


def test_figures_of_a_backbone() -> None:
    (row,) = stereo_rows([scored("net")])
    values = row.values
    assert (values["stereo"], values["dataset"], values["status"]) == ("net", "toy", "done")
    assert (values["d1_percent"], values["d1_all_percent"]) == (25.0, 25.0)
    assert values["d1_all_image_mean_percent"] == 50.0
    assert (values["epe_px"], values["bad3_percent"]) == (0.875, 25.0)
    assert values["holes_percent"] == 20.0
    assert (values["ms_per_frame"], values["peak_memory_gb"]) == (30.0, 1.5)


def test_runs_stand_beside_their_backbone(tmp_path: Path) -> None:
    runs = [
        make_run(tmp_path / "a", {"name": "net"}, 20.0, 0.25),
        make_run(tmp_path / "b", {"name": "net"}, 22.0, 0.35),
        make_run(tmp_path / "c", {"name": "other"}, 24.0),
    ]
    net, other = stereo_rows([scored("net"), scored("other", Broken("it broke"))], runs)
    slam = ("psnr_db", "lpips", "depth_l1_cm", "s_per_frame")
    assert [net.values[key] for key in slam] == [21.0, pytest.approx(0.3), 210.0, pytest.approx(0.6)]
    assert net.notes == ("SLAM: mean of the runs a on kitti/06, b on kitti/06",)
    assert (other.values["status"], other.values["psnr_db"]) == ("failed", 24.0)
    assert "lpips" not in other.values
    assert other.notes == ("it broke", "SLAM: run c on kitti/06")


def test_settings_tell_apart_rows_of_one_plugin(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / "a", {"name": "net", "scale": 0.5}, 20.0)]
    runs.append(make_run(tmp_path / "b", {"name": "net", "scale": 0.25}, 22.0))
    full, half, unknown = stereo_rows([scored("net", scale=1.0), scored("net (scale=0.5)", scale=0.5)], runs)
    assert "psnr_db" not in full.values
    assert half.values["psnr_db"] == 20.0
    assert (unknown.values["stereo"], unknown.values["status"]) == ("net", "not scored as stereo")
    assert unknown.values["psnr_db"] == 22.0
    # A plugin with one row takes its runs whatever their settings: plugins gain settings as time goes by.
    assert stereo_rows([scored("net", scale=1.0)], runs)[0].values["psnr_db"] == 21.0


def test_every_form(tmp_path: Path) -> None:
    rows = stereo_rows([scored("net"), scored("bad_net", Broken("it | broke"))])
    document = runs_document(rows, STEREO_COLUMNS)
    text = text_of(document, "md", tmp_path)
    assert "| Stereo | Dataset | Status | EPE [px] |" in text
    assert "SLAM" not in text
    assert "- bad\\_net: it \\| broke" in text
    assert f"truth {TRUE_DISPARITY}, images 3, averaging pooled" in text
    header, net, bad = text_of(document, "csv", tmp_path).splitlines()
    assert header.startswith("stereo,dataset,status,epe_px,")
    assert net.startswith("net,toy,done,0.875,")
    assert bad.startswith("bad_net,toy,failed,,")
    latex = text_of(document, "tex", tmp_path)
    assert r"bad\_net & toy & failed & -" in latex
    run = make_run(tmp_path / "a", {"name": "net"}, 20.0)
    with_run = runs_document(stereo_rows([scored("net")], [run]), STEREO_COLUMNS)
    assert "SLAM PSNR [dB]" in text_of(with_run, "md", tmp_path)
    assert '<th scope="col" class="n">SLAM PSNR<small>[dB]</small></th>' in text_of(with_run, "html", tmp_path)


def test_one_row_an_image() -> None:
    table = image_table([scored("net"), scored("bad", Broken("it broke"))])
    assert [tuple(row) for row in table] == [IMAGE_COLUMNS] * 3
    assert [(row["number"], row["truth_pixels"], row["d1_percent"], row["ms"]) for row in table] == [
        (1, 1, 100.0, 100.0),
        (2, 3, 0.0, 20.0),
        (3, 0, None, 30.0),
    ]
