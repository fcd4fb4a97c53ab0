"""The pictures of a report: which frames of a run are shown, and their thumbnails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.contracts.saved_run import SavedRun, SavedView
from bench.errors import BenchError
from bench.evaluation.depth import depth_reference
from bench.evaluation.saved_run import SavedRunFolder
from bench.report.pages.shown_run import ShownRun, seen_by_mapping, values_of
from bench.runs.folder import VIEWS, View, picture_path
from bench.types import Image, Map

WIDTH_PX = 640
"""Wider pictures are shrunk to this."""
ERROR_RANGE = 0.25
"""Errors of colour from here on, of 1, have the brightest colour."""
DEPTH_ERROR_RANGE = 0.2
"""And errors of depth from here on, as a share of the reference."""
_QUALITY = 75
_WORST = 50
_DEPTH_COLORS, _ERROR_COLORS = cv2.COLORMAP_TURBO, cv2.COLORMAP_INFERNO
# Of the scored values of a view, those that stand below it: column, heading, unit, digits.
_VALUES = (("psnr_db", "PSNR", "dB", 2), ("ssim", "SSIM", "", 3), ("lpips", "LPIPS", "", 3),
           ("depth_l1_cm", "Depth-L1", "cm", 1), ("ate_m", "Error of position", "m", 3))  # fmt: skip


@dataclass(frozen=True)
class ShownView:
    """One view on a page. ``files`` are its pictures by what they show; ``problem`` says what lacks."""

    camera: View
    number: int
    why: str
    """Why it was chosen."""
    seen: str
    unseen: bool
    scores: tuple[tuple[str, str], ...]
    """Names and values with their units."""
    psnr_db: float | None
    files: dict[str, str]
    size: tuple[int, int] = (0, 0)
    """Width and height of its pictures."""
    depth_range_m: tuple[float, float] | None = None
    problem: str = ""

    @property
    def key(self) -> str:
        """What the same view of another run is called too."""
        return f"{self.camera} {self.number}"


def chosen_views(run: ShownRun, count: int) -> list[tuple[View, int, str]]:
    """At most ``count`` views with a saved render: one half the worst by PSNR, worst first, the other evenly spaced.

    Where nothing is scored all of them are evenly spaced. Runs of the same frames have the same evenly spaced ones.
    """
    if run.frames.empty or count < 1:
        return []
    numbers = [int(number) for number in run.frames["number"]]
    there = {(camera, number) for camera in VIEWS for number in numbers if _has_render(run, camera, number)}
    worst = [(value, camera, number) for camera in VIEWS for number, value in values_of(run, camera, "psnr_db").items()]
    worst = sorted(each for each in worst if each[1:] in there)[: count // 2]
    found: dict[tuple[View, int], str] = {(camera, int(number)): "among the worst" for _, camera, number in worst}
    spaced = np.unique(np.linspace(0, len(numbers) - 1, count - len(found)).round().astype(int))
    for place in spaced:
        if ("left", numbers[place]) in there:
            found.setdefault(("left", numbers[place]), "evenly spaced")
    return [(camera, number, why) for (camera, number), why in found.items()]


def worst_views(run: ShownRun) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and lines of a table of the views that scored worst, by PSNR; no lines where none has one."""
    known = [each for each in _VALUES if each[0] in run.views]
    headings = ("Frame", "Camera", "Seen", *(f"{title} [{unit}]" if unit else title for _, title, unit, _ in known))
    if "psnr_db" not in run.views:
        return headings, []
    lines = []
    for view in run.views.dropna(subset=["psnr_db"]).nsmallest(_WORST, "psnr_db").to_dict("records"):
        texts = ("-" if view[key] != view[key] else f"{view[key]:.{digits}f}" for key, _, _, digits in known)
        lines.append((str(view["number"]), view["view"], seen_by_mapping(run, view["view"], view["number"])[0], *texts))
    return headings, lines


def missing_renders(run: ShownRun) -> str:
    """What a finished run lacks of its renders, as a sentence; empty where nothing lacks or nobody can tell."""
    if run.saved is None or run.frames.empty:
        return ""
    try:
        if not any(run.saved.rendered(camera) for camera in VIEWS):
            return "This run has no saved renders, so there are no pictures of it."
    except BenchError as error:
        return str(error)
    return ""


def write_views(run: ShownRun, chosen: Sequence[tuple[View, int, str]], folder: Path) -> Iterator[ShownView]:
    """Write the pictures of these views into ``folder`` one after the other; what can't be read is said instead.

    Where the data set can't be read the renders are shown alone.
    """
    assert isinstance(run.saved, SavedRunFolder)
    for camera, number, why in chosen:
        seen, unseen = seen_by_mapping(run, camera, number)
        scores = {column: values_of(run, camera, column).get(number) for column, *_ in _VALUES}
        texts = tuple(
            (title, f"{scores[column]:.{digits}f} {unit}".strip())
            for column, title, unit, digits in _VALUES
            if scores[column] is not None
        )
        files = _Files(folder, f"{camera}-{number:06d}")
        limits, problem = None, ""
        try:
            render = run.saved.render(camera, number)
            if render is not None:
                files.keep("render", render)
            limits = _write(run.saved.views_of(number, [camera])[0], run.saved, files)
        except BenchError as error:
            problem = str(error)
        psnr = scores["psnr_db"]
        yield ShownView(camera, number, why, seen, unseen, texts, psnr, files.names, files.size, limits, problem)


class _Files:
    """Writes the pictures of one view; ``names`` says where each is."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder, self._name = folder, name
        self.names: dict[str, str] = {}
        self.size = (0, 0)

    def keep(self, what: str, picture: Image) -> None:
        """Write one, RGB (H, W, 3), as a thumbnail."""
        height, width = picture.shape[:2]
        if width > WIDTH_PX:
            size = (WIDTH_PX, max(1, round(height * WIDTH_PX / width)))
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        done, encoded = cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
        assert done
        self.names[what], self.size = f"{self._name}-{what}.webp", (bgr.shape[1], bgr.shape[0])
        (self._folder / self.names[what]).write_bytes(encoded.tobytes())


def _has_render(run: ShownRun, camera: View, number: int) -> bool:
    return picture_path(run.record.source, camera, "color", number).is_file()


def _write(view: SavedView, run: SavedRun, files: _Files) -> tuple[float, float] | None:
    """Write what there is of a view beside its render; gives the range of its depth's colours in metres."""
    if view.render is not None:
        files.keep("truth", view.image)
        difference = cv2.absdiff(view.render, view.image).mean(axis=2, dtype=np.float32) / np.float32(255)
        files.keep("error", _colored(difference / np.float32(ERROR_RANGE), _ERROR_COLORS))
    if view.depth is None:
        return None
    reference = depth_reference(view, run.protocol)
    limits = _depth_range(view.depth if reference is None else reference)
    if limits is None:
        return None
    low, high = np.log(limits)
    shade = (np.log(np.maximum(view.depth, 1e-6)) - low) / (high - low)
    files.keep("depth", _colored(shade, _DEPTH_COLORS))
    if reference is not None:
        # As Depth-L1 counts it: where nothing was rendered the depth is 0.
        most = np.inf if run.protocol.depth_max_m is None else run.protocol.depth_max_m
        counts = (reference > run.protocol.depth_min_m) & (reference < most)
        error = np.where(counts, np.abs(np.nan_to_num(view.depth) - reference) / reference, np.float32(np.nan))
        shade = np.asarray(error / DEPTH_ERROR_RANGE, dtype=np.float32)
        files.keep("depth-error", _colored(_thick(shade), _ERROR_COLORS))
    return limits


def _depth_range(depth: Map) -> tuple[float, float] | None:
    known = depth[np.isfinite(depth) & (depth > 0)]
    if not len(known):
        return None
    low, high = (float(limit) for limit in np.percentile(known, (2, 98)))
    return low, max(high, 1.01 * low)


def _thick(values: Map) -> Map:
    """Single pixels (others NaN) as squares that a thumbnail still shows; of two at one place the larger value."""
    side = 3 if values.shape[1] > 400 else 1
    spread = cv2.dilate(np.nan_to_num(values, nan=-1.0), np.ones((side, side), np.uint8))
    return np.where(spread < 0, np.float32(np.nan), spread)


def _colored(values: Map, colors: int) -> Image:
    """Values from 0 to 1 as colours, RGB; what is not known is grey."""
    shade = np.clip(np.nan_to_num(values, nan=0.0) * 255, 0, 255).astype(np.uint8)
    made = cv2.cvtColor(cv2.applyColorMap(shade, colors), cv2.COLOR_BGR2RGB)
    made[~np.isfinite(values)] = 128
    return np.asarray(made, dtype=np.uint8)
