"""The page of ``bgs-bench view`` in Chromium: from a frame's camera it shows what the map's own renderer draws."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from bench.cli import main
from bench.evaluation.saved_run import SavedRunFolder
from bench.runs.folder import color_to_8bit
from bench.saved_map import SavedMap, load_map
from bench.types import Image, PinholeView

pytestmark = [pytest.mark.browser, pytest.mark.slow]
WIDTH, HEIGHT, LAST = 320, 96, 3
STREET = (f"dataset.width={WIDTH}", f"dataset.height={HEIGHT}", f"dataset.frames={LAST + 1}", "protocol.lpips=false")
# The page is as high as the camera's image times this; its middle is looked at, beside which there are other things.
_TIMES = 6
_PAGE = {"width": 1600, "height": _TIMES * HEIGHT}
_LOOKED_AT_PX = 800
HOSTILE = """x"><img src=x onerror=window.hurt=1> 'a' | b & {1}"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view") / "run"
    assert main(["run", "system=bgs_slam_fast", "tracker=groundtruth", *STREET, f"output={folder}"]) == 0
    hostile = shutil.move(folder, folder.with_name(HOSTILE))
    (hostile / "views/left/color/000001.png").write_bytes(b"spoilt")
    return Path(hostile)


@pytest.fixture(scope="module")
def opened(browser: Any, run: Path) -> Iterator[Any]:
    """The page, which may ask nobody but its server for anything."""
    pytest.importorskip("viser", reason="viser is not installed; make browser-test")
    from bench.viewers.page import Page

    served = Page(SavedRunFolder(run), "127.0.0.1", 18080, 1_000_000)
    page = browser.new_page(viewport=_PAGE)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(served.url)
    yield page
    page.close()
    served.stop()
    assert [url for url in asked if not url.startswith((served.url, "data:", "blob:"))] == []


def own(run: Path, number: int, keep: Callable[[SavedMap], torch.Tensor] | None = None) -> Image:
    """The map, or some of its Gaussians, from a frame's camera by our own renderer, as it is seen in the page."""
    saved = load_map(run)
    if keep is not None:
        saved.gaussians.keep(keep(saved))
    assert saved.camera is not None
    view = PinholeView.of(saved.camera.scaled(_TIMES), saved.view_of(number).T_world_cam)
    return middle(color_to_8bit(saved.render(view).color))


def middle(picture: Image) -> Image:
    first = (picture.shape[1] - _LOOKED_AT_PX) // 2
    return np.ascontiguousarray(picture[:, first : first + _LOOKED_AT_PX])


def psnr_when_settled(page: Any, expected: Image) -> float:
    """PSNR in dB of what is seen in the end against the picture, once it is 30 or changes no more."""
    psnr = 0.0
    for _ in range(20):
        page.wait_for_timeout(1000)
        shot = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR_RGB)
        before, psnr = psnr, cv2.PSNR(middle(np.asarray(shot, np.uint8)), expected)
        if psnr > 30 or psnr == before > 20:
            break
    return psnr


def set_number(page: Any, place: int, value: int) -> None:
    field = page.locator(".mantine-NumberInput-input").nth(place)
    field.fill(str(value))
    field.press("Enter")


def test_the_map_is_seen_as_it_is_rendered(opened: Any, run: Path) -> None:
    """So axes, colours, opacity and field of view are right; and without the sky, and as it was."""
    whole = own(run, 0)
    assert whole.std() > 30
    assert psnr_when_settled(opened, whole) > 30
    set_number(opened, 1, LAST)
    assert psnr_when_settled(opened, own(run, LAST)) > 30
    sky, age = opened.get_by_label("Sky", exact=True), np.load(run / "map_keyframes.npy")
    sky.click()
    assert psnr_when_settled(opened, own(run, LAST, lambda m: torch.arange(len(m)) >= m.gaussians.sky)) > 30
    sky.click()
    set_number(opened, 0, 0)
    early = own(run, LAST, lambda _: torch.from_numpy(age <= 0))
    assert cv2.PSNR(early, own(run, LAST)) < 30
    assert psnr_when_settled(opened, early) > 30


def test_a_run_plays_and_its_text_stays_text(opened: Any) -> None:
    play = opened.get_by_label("Play", exact=True)
    play.click()
    opened.get_by_text("Frame 1, keyframe").wait_for()
    opened.get_by_text("views/left/color/000001.png is damaged").wait_for()
    opened.get_by_text("Frame 2").wait_for()
    play.click()
    assert opened.get_by_text(HOSTILE).count() > 0
    assert opened.evaluate("window.hurt") is None
