"""The report's pages, read as HTML: what stands on them is what the run folders hold, and nothing is left blank."""

from __future__ import annotations

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.report.pages import map_page, site
from bench.report.pages.shown_run import read_shown_run
from bench.tables.collect import collect_row
from tests.evaluation.tiny_run import HELD_OUT, LEFT_ERROR, LOST, write_tiny_run
from tests.report.conftest import HOSTILE, tiny_config


class Page(HTMLParser):
    """A page's tables as texts, what it loads, its scripts, and all its text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.tables, self.loads, self.json = path, [], [], []
        self.tags: list[str] = []
        self.text = ""
        self._script = False
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = dict(attributes)
        self.tags.append(tag)
        self.loads += [value for name, value in attributes if name in ("src", "href", "data-src") and value]
        if tag == "table":
            self.tables.append([])
        elif tag == "tr" and self.tables:
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        elif tag == "script":
            self._script = found.get("type") == "application/json"
            if self._script:
                self.json.append("")

    def handle_endtag(self, tag: str) -> None:
        self._script = self._script and tag != "script"

    def handle_data(self, data: str) -> None:
        if self._script:
            self.json[-1] += data
            return
        self.text += data
        if self.tables and self.tables[-1] and self.tables[-1][-1]:
            self.tables[-1][-1][-1] += data.strip()


def report(runs: list[Path], out: Path, **options: Any) -> tuple[Page, list[str]]:
    first, lacking = site.write_report(runs, out, options.get("views"), options.get("maps", 0), lambda *_: None)
    return Page(first), lacking


@pytest.fixture(scope="module")
def one(scored_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Page:
    return report([scored_run], tmp_path_factory.mktemp("one") / "report")[0]


def test_numbers_are_those_of_the_runs_table(one: Page, scored_run: Path) -> None:
    shown = dict(row for row in one.tables[0] if len(row) == 2)
    row = collect_row(scored_run).values
    assert shown["PSNR [dB]"] == f"{row['psnr_db']:.2f}"
    assert shown["ATE [m]"] == f"{row['ate_rmse_m']:.3f}"
    assert shown["Status"] == "done, 1 frames lost"
    protocol = dict(row for row in one.tables[1] if len(row) == 2)
    assert protocol["holdout_every"] == "5"


def test_all_that_a_page_loads_lies_beside_it(one: Page) -> None:
    files = [name.partition("?")[0] for name in one.loads if not name.startswith(("#", "data:"))]
    assert files
    assert [name for name in files if not (one.path.parent / name).is_file()] == []
    assert not any(re.match(r"(\w+:)?//", name) for name in one.loads)


def test_worst_views_come_first_with_what_mapping_saw_of_them(one: Page) -> None:
    worst = one.tables[-1]
    assert worst[0][:3] == ["Frame", "Camera", "Seen"]
    # The right views are all off by 16 of 255, the held-out left view by 8.
    assert [row[1] for row in worst[1:6]] == ["right"] * 4 + ["left"]
    assert worst[1][2] == "right camera, unseen by mapping"
    assert worst[5][:3] == [str(HELD_OUT), "left", "held out, unseen by mapping"]
    assert worst[5][3] == f"{20 * np.log10(255 / LEFT_ERROR[HELD_OUT]):.2f}"


def test_pictures_show_the_error_that_was_put_in(one: Page, scored_run: Path) -> None:
    run = read_shown_run(scored_run)
    chosen = site.chosen_views(run, 8)
    assert next((camera, number) for camera, number, why in chosen if why == "among the worst")[0] == "right"
    folder = one.path.parent / "runs" / "001"
    error = cv2.imread(str(folder / f"left-{HELD_OUT:06d}-error.webp"))
    shade = np.full((1, 1), round(255 * LEFT_ERROR[HELD_OUT] / 255 / site.ERROR_RANGE), np.uint8)
    expected = cv2.applyColorMap(shade, cv2.COLORMAP_INFERNO)[0, 0].astype(int)
    assert np.abs(error.reshape(-1, 3).mean(axis=0) - expected).max() < 4
    # Nothing was rendered at the held-out frame, 10 m where LiDAR says 12 m at the others: both are 20 % off or more.
    depth_error = cv2.imread(str(folder / "left-000010-depth-error.webp"))
    brightest = cv2.applyColorMap(np.full((1, 1), 212, np.uint8), cv2.COLORMAP_INFERNO)[0, 0].astype(int)
    assert np.abs(depth_error[:18].reshape(-1, 3).mean(axis=0) - brightest).max() < 6
    assert np.abs(depth_error[24:].reshape(-1, 3).mean(axis=0) - 128).max() < 3
    assert not (folder / f"left-{LOST:06d}-render.webp").exists()


def test_figures_have_the_runs_numbers_and_a_gap_where_it_was_lost(one: Page, scored_run: Path) -> None:
    figures = [json.loads(text) for text in one.json]
    names = [trace["name"] for trace in figures[0]["data"]]
    assert names == ["ground truth", "estimate, 4 frames", "lost, 1 frames"]
    per_frame = pd.read_csv(scored_run / "per_frame.csv").set_index(["view", "number"])["psnr_db"]
    drawn = site.curves_of(read_shown_run(scored_run))[0].series["mapped views"]
    assert drawn.index.tolist() == [10, 11, LOST, 14]
    assert np.isnan(drawn[LOST])
    assert drawn.drop(LOST).tolist() == [per_frame["left", number] for number in (10, 11, 14)]


def broken(path: Path, scored_run: Path, how: str) -> Path:
    shutil.copytree(scored_run, path)
    if how == "no_views":
        shutil.rmtree(path / "views")
    elif how == "one_render":
        (path / "views" / "left" / "color" / "000011.png").unlink()
    elif how == "damaged_render":
        (path / "views" / "left" / "color" / "000013.png").write_bytes(b"\x89PNG nothing")
    elif how == "unscored":
        (path / "metrics.json").unlink()
        (path / "per_frame.csv").unlink()
    elif how == "moved":
        truth = (path / "ground_truth.csv").read_text().splitlines()
        truth[1] = truth[1].replace(",10.0", ",17.0")
        (path / "ground_truth.csv").write_text("\n".join(truth) + "\n")
    elif how == "other_images":
        config = (path / "config.yaml").read_text().replace("tiny_for_tests", "not_there")
        (path / "config.yaml").write_text(config)
    elif how == "no_per_frame":
        (path / "per_frame.csv").unlink()
    else:
        status = json.loads((path / "status.json").read_text())
        status |= {"state": "out_of_memory", "reason": "7.9 GB were used", "frames_done": 3}
        (path / "status.json").write_text(json.dumps(status))
    return path


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("no_views", "no saved renders"),
        ("one_render", "000011.png is missing though the run is done"),
        ("damaged_render", "000013.png is damaged"),
        ("unscored", "was not scored; `bgs-bench evaluate"),
        ("moved", "no trajectory is drawn"),
        ("other_images", "not_there"),
        ("no_per_frame", "per_frame.csv is missing"),
        ("failed", "not done (out of memory after 3 of 5 frames): 7.9 GB were used"),
    ],
)
def test_what_a_run_lacks_is_said_and_the_rest_comes(tmp_path: Path, scored_run: Path, how: str, said: str) -> None:
    page, lacking = report([broken(tmp_path / "run", scored_run, how)], tmp_path / "out")
    assert said in page.text
    assert any(said in sentence for sentence in lacking)
    assert ("There is no trajectory to draw" in page.text) == (how == "moved")
    renders = list((tmp_path / "out" / "runs" / "001").glob("*-render.webp"))
    assert bool(renders) == (how != "no_views")
    assert ("worst of" in page.text) == (how not in ("unscored", "no_per_frame"))


def test_a_runs_text_stays_text(tmp_path: Path, scored_run: Path) -> None:
    runs = [tmp_path / HOSTILE.replace("/", "_"), tmp_path / "b"]
    for run, seed in zip(runs, (0, 1), strict=True):
        shutil.copytree(scored_run, run)
        config = (run / "config.yaml").read_text()
        run.joinpath("config.yaml").write_text(config.replace("seed: 0", f"seed: {seed}"))
    metrics = json.loads((runs[0] / "metrics.json").read_text())
    metrics["notes"] = {HOSTILE: HOSTILE}
    metrics["protocol"]["name"] = HOSTILE
    (runs[0] / "metrics.json").write_text(json.dumps(metrics))
    first, _ = report(runs, tmp_path / "out")
    for path in (first.path, *first.path.parent.glob("runs/*/index.html")):
        page = Page(path)
        # Our two scripts, and data; a script of the run's would come beside these.
        assert page.tags.count("script") == 2 + len(page.json)
        assert all(json.loads(text) for text in page.json)
        assert "<script>window" not in path.read_text()
    assert HOSTILE in first.text
    names = [trace["name"] for text in first.json if "scatter" in text for trace in json.loads(text)["data"]]
    # Plotly takes tags for tags, so a name in a figure is escaped once more.
    assert any("&lt;script&gt;" in name for name in names)
    assert not any("<" in name for name in names)


def test_several_runs_lead_to_their_pages_and_failed_ones_are_told(tmp_path: Path, scored_run: Path) -> None:
    failed = broken(tmp_path / "failed", scored_run, "failed")
    page, lacking = report([scored_run, failed], tmp_path / "out")
    assert page.tables[0][1][0] == "scored"
    assert {"runs/001/index.html", "runs/002/index.html"} <= set(page.loads)
    assert "Not finished, not scored or damaged" in page.text
    assert [sentence for sentence in lacking if sentence.startswith("failed: This run is not done")]
    beside = json.loads(next(text for text in page.json if text.startswith('{"tiny')))
    assert [each["run"] for each in beside["tiny_for_tests, left 10"]] == ["scored", "failed"]
    again, _ = report([scored_run], tmp_path / "out")
    assert not (tmp_path / "out" / "runs" / "002").exists()
    assert "All runs" not in again.text


def test_nothing_of_a_folder_that_is_no_report_is_touched(tmp_path: Path, scored_run: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(BenchError, match="holds no report"):
        site.write_report([scored_run], tmp_path, None, 0, lambda *_: None)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_the_map_says_what_it_needs(tmp_path: Path, scored_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BGS_MAP_VIEWER", str(tmp_path))
    page, _ = report([scored_run], tmp_path / "out", maps=1)
    assert "make map-viewer" in page.text or "needs node" in page.text
    monkeypatch.setattr(map_page, "viewer", lambda: ["false"])
    with pytest.raises(BenchError, match="splat-transform can't write"):
        map_page.write_map_page(["false"], tmp_path / "map.ply", None, tmp_path / "map.html")
    assert not (tmp_path / "map.html").exists()


@pytest.mark.parametrize(
    ("mapper", "file", "said"),
    [
        ("gaussian", "", "map.ply is not there, so there is no map in 3D"),
        ("gaussian", "link", "map.ply is not there, so there is no map in 3D"),
        ("point_slam", "points.npz", "points.npz is no map of Gaussians as PLY"),
        ("none", "", r"its mapper \(none\) saves none"),
    ],
)
def test_what_is_no_map_in_3d(tmp_path: Path, mapper: str, file: str, said: str) -> None:
    run = write_tiny_run(tmp_path / "run", tiny_config(mapper={"name": mapper}))
    if file == "link":
        (tmp_path / "map.ply").touch()
        (run / "map.ply").symlink_to(tmp_path / "map.ply")
    elif file:
        (run / file).touch()
    with pytest.raises(BenchError, match=said):
        map_page.shown_map(SavedRunFolder(run))


def test_the_makefile_installs_the_version_that_the_page_names() -> None:
    makefile = (Path(__file__).parents[2] / "Makefile").read_text()
    assert f"@playcanvas/splat-transform@{map_page.VERSION}\n" in makefile


def test_the_command_writes_the_pages_and_says_where(
    tmp_path: Path, scored_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(scored_run), "--out", str(tmp_path / "out"), "--maps", "0", "--views", "0"]) == 0
    assert capsys.readouterr().out == f"wrote {tmp_path / 'out' / 'index.html'}\n"
    assert "There are no saved views to show" in (tmp_path / "out" / "index.html").read_text()
    assert main(["report", str(scored_run), "--views", "-1"]) == 2
    assert main(["report", str(tmp_path / "nothing")]) == 2
