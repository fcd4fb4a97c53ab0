"""The report in Chromium: it opens from disk, says nothing on the console, asks for nothing, and does what it shows."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from bench.errors import BenchError
from bench.gaussians.map import GaussianMap
from bench.report.pages import map_page, site
from tests.report.conftest import HOSTILE

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def report(scored_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of two settings with two seeds; a run with a hostile name has a map, where splat-transform is there."""
    folder = tmp_path_factory.mktemp("browser")
    names = [HOSTILE.replace("/", "_"), "b", "c", "d"]
    for place, name in enumerate(names):
        run = shutil.copytree(scored_run, folder / "runs" / name)
        config = (run / "config.yaml").read_text().replace("seed: 0", f"seed: {place % 2}")
        (run / "config.yaml").write_text(config.replace("iterations: 1", f"iterations: {1 + place // 2}"))
    gaussians = GaussianMap(0, torch.device("cpu"))
    planes = torch.randn(gaussians.planes.shape[0], 300, generator=torch.Generator().manual_seed(0))
    planes[6:10] = torch.nn.functional.normalize(planes[6:10], dim=0)
    # Before the first camera, which stands at z = 10.
    planes[2] += 20.0
    gaussians.add(10, np.eye(4), planes, torch.ones(300))
    gaussians.save(folder / "runs" / names[0] / "map.ply")
    runs = [folder / "runs" / name for name in names]
    return site.write_report(runs, folder / "report", None, 1, lambda *_: None)[0]


@pytest.fixture
def opened(browser: Any, report: Path) -> Iterator[Any]:
    """Opens pages; at the end none of them may have said something on the console, or asked for anything outside."""
    said: list[str] = []
    contexts = []

    def open_page(path: Path = report, width: int = 1280, scheme: str = "light") -> Any:
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text) if message.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("requestfailed", lambda request: said.append(f"failed: {request.url}"))
        page.on("request", lambda asked: None if _is_local(asked.url) else said.append(f"asked for {asked.url}"))
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []


def _is_local(url: str) -> bool:
    return url.startswith(("file:", "data:", "blob:"))


def _scroll_through(page: Any) -> None:
    for top in range(0, page.evaluate("document.documentElement.scrollHeight"), 700):
        page.evaluate(f"scrollTo(0, {top})")
        page.wait_for_timeout(60)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 400])
def test_pages_draw_all_and_fit(opened: Any, report: Path, width: int, scheme: str) -> None:
    for path in (report, report.parent / "runs" / "001" / "index.html"):
        page = opened(path, width, scheme)
        _scroll_through(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate("window.hurt") is None
        plots = page.locator(".plot")
        assert plots.count() > 2
        for place in range(plots.count()):
            assert plots.nth(place).locator("svg.main-svg").count() > 0
        broken = "[...document.images].filter((one) => one.complete && !one.naturalWidth).length"
        assert page.evaluate(broken) == 0
        red, green, blue = (int(each) for each in page.evaluate(
            "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3)"
        ))  # fmt: skip
        assert (red + green + blue > 600) == (scheme == "light")


def test_names_are_text_in_figures_too(opened: Any) -> None:
    page = opened()
    names = page.locator("#runs tbody").first.locator("th").all_inner_texts()
    assert HOSTILE.replace("/", "_") in names
    assert page.locator("#runs script").count() == 0


def test_tables_sort_by_key_and_click(opened: Any) -> None:
    page = opened()
    button = page.get_by_role("button", name="Seed").first
    seeds = "[...document.querySelectorAll('#runs table')[0].tBodies[0].rows].map((row) => row.cells[COLUMN].innerText)"
    heads = page.locator("#runs table").first.locator("thead th").all_inner_texts()
    column = next(place for place, text in enumerate(heads) if text.strip().startswith("Seed"))
    for way, expected in (("click", ["0", "0", "1", "1"]), ("Enter", ["1", "1", "0", "0"])):
        button.click() if way == "click" else button.press(way)
        assert page.evaluate(seeds.replace("COLUMN", str(column))) == expected


def test_the_slider_moves_by_key_and_pictures_change(opened: Any, report: Path) -> None:
    page = opened(report.parent / "runs" / "001" / "index.html")
    figure = page.locator(".compare").first
    slider, over = figure.locator("input[type=range]"), figure.locator(".over")
    slider.focus()
    slider.press("End")
    assert over.evaluate("one => getComputedStyle(one).clipPath") == "inset(0px 0px 0px 100%)"
    slider.press("Home")
    # No more than the picture's left edge is left of it.
    assert over.evaluate("one => getComputedStyle(one).clipPath") in ("inset(0px 0px 0px 0%)", "inset(0px)")
    figure.locator("select[data-side=right]").select_option("error")
    assert over.get_attribute("src").endswith("-error.webp")


def test_runs_beside_each_other_and_pairs_are_chosen(opened: Any) -> None:
    page = opened()
    assert page.locator("#beside-cards figure").count() == 5
    page.locator("#beside-what").select_option("error")
    assert page.locator("#beside-cards figure").count() == 4
    shown = page.locator(".pair:not([hidden])")
    assert shown.count() == 1
    assert "mapper.iterations: 1 and 2; seeds 0, 1" in shown.inner_text()


def test_the_map_in_3d_is_not_blank(opened: Any, report: Path) -> None:
    try:
        map_page.viewer()
    except BenchError as error:
        pytest.skip(str(error))
    page = opened(report.parent / "runs" / "001" / "index.html")
    page.get_by_role("button", name="Show the map here").click()
    canvas = page.frame_locator("iframe").locator("canvas")
    canvas.wait_for()
    for _ in range(40):
        page.wait_for_timeout(500)
        picture = cv2.imdecode(np.frombuffer(canvas.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        differing = (np.abs(picture.astype(int) - 102).max(axis=2) > 20).mean()
        if differing > 0.02:
            break
    # The viewer's background is a grey of 0.4.
    assert differing > 0.02
