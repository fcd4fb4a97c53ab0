"""The report's folder: its pages, their pictures, and what they load, all beside each other."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import islice
from pathlib import Path
from typing import Any

import jinja2
import plotly.graph_objects as go
from markupsafe import Markup

from bench.errors import BenchError
from bench.evaluation.saved_run import ProgressReport, SavedRunFolder
from bench.io.atomic import write_bytes, write_text
from bench.plain_text import plain_line
from bench.report.pages.curves import curve_figure, curves_of, overlays, trajectory_figure
from bench.report.pages.map_page import shown_map, viewer, write_map_page
from bench.report.pages.paired import CONFIDENCE, pairs_of
from bench.report.pages.pictures import (
    DEPTH_ERROR_RANGE,
    ERROR_RANGE,
    ShownView,
    chosen_views,
    missing_renders,
    worst_views,
    write_views,
)
from bench.report.pages.shown_run import ShownRun, read_shown_run
from bench.report.pages.sweeps import MOST_FIGURES, Named, Sweep, against_settings, against_two, pareto, sweeps_of
from bench.tables.collect import Column, columns_of
from bench.tables.document.model import UNKNOWN, Document
from bench.tables.groups import by_settings, group_runs
from bench.tables.records.made import made_in_words
from bench.tables.records.portable import portable_config
from bench.tables.records.settings import settings_of
from bench.tables.render import runs_document

_TEMPLATES = Path(__file__).parent / "templates"
_ASSETS = ("report.css", "report.js")
INDEX = "index.html"
# All runs together show about this many views, each run at least and at most so many.
_VIEWS_IN_ALL, _FEWEST, _MOST = 400, 8, 24


@dataclass(frozen=True)
class Choice:
    """Figures of one kind, one of which is shown at a time; ``left_out`` is how many more there would be."""

    title: str
    caption: str
    figures: tuple[tuple[str, Markup], ...]
    left_out: int = 0


@dataclass(frozen=True)
class RunPage:
    """What a run's page holds; ``base`` leads from the index to the folder of its pictures.

    ``label`` tells the run from the others by its settings and its seed; the run's name where these don't.
    """

    run: ShownRun
    label: str
    base: str
    views: tuple[ShownView, ...]
    problems: tuple[str, ...]
    no_map: str
    """Why there is no map in 3D; empty where there is one."""
    trajectory: Markup | None
    curves: tuple[tuple[str, Markup], ...]

    @property
    def name(self) -> str:
        """The run's name, that of its folder."""
        return self.run.record.name


def write_report(
    folders: Sequence[Path], out: Path, views: int | None, maps: int, on_progress: ProgressReport
) -> tuple[Path, list[str]]:
    """Write the report of these run folders into the folder ``out``; its first page, and what lacks, in sentences.

    ``views`` are shown of each run (None: as many as keep the report small), and the first ``maps`` runs get their maps
    in 3D. ``on_progress`` is told of each run. Raises ``BenchError`` where ``out`` is no folder for a report.
    """
    _require_own(out)
    shutil.rmtree(out / "runs", ignore_errors=True)  # those of an older report
    read = {id(run.row): run for run in map(read_shown_run, folders)}
    runs = [read[id(row)] for row in by_settings([run.row for run in read.values()])]
    labels = _labels(runs)
    count = min(_MOST, max(_FEWEST, _VIEWS_IN_ALL // len(runs))) if views is None else views
    pages = []
    for place, run in enumerate(runs, 1):
        on_progress("runs", place - 1, len(runs))
        pages.append(_page(run, labels[place - 1], place, out, count, maps))
    on_progress("runs", len(runs), len(runs))
    templates = _templates()
    common = {"error_range": ERROR_RANGE, "depth_error_range": DEPTH_ERROR_RANGE, "views_each": count}
    for asset in _ASSETS:
        write_text(out / asset, (_TEMPLATES / asset).read_text("utf-8"))
    write_bytes(out / "plotly.min.js", (files("plotly") / "package_data" / "plotly.min.js").read_bytes())
    for page in pages:
        alone, document = len(pages) == 1, _each([page.run])
        text = templates.get_template("run.html").render(
            page=page, root="" if alone else "../../", base=page.base if alone else "", alone=alone,
            details=_details(page.run, document), document=document, worst=worst_views(page.run), **common,
        )  # fmt: skip
        write_text(out / (INDEX if alone else f"{page.base}{INDEX}"), text)
    if len(pages) > 1:
        write_text(out / INDEX, templates.get_template("index.html").render(**_overview(pages), **common))
    lacking = [f"{page.name}: {problem}" for page in pages for problem in page.problems]
    return out / INDEX, lacking + list(dict.fromkeys(page.no_map for page in pages[:maps] if page.no_map))


def _labels(runs: Sequence[ShownRun]) -> list[str]:
    grouped = group_runs([run.row for run in runs])
    if len(grouped.rows) < 2 or not grouped.settings:
        return [run.record.name for run in runs]
    groups = {run.source: grouped.label(row) for row in grouped.rows for run in row.runs}
    return [f"{groups[run.record.source]}, seed {run.record.seed}" for run in runs]


def _page(run: ShownRun, label: str, place: int, out: Path, count: int, maps: int) -> RunPage:
    base = f"runs/{place:03d}/"
    folder = out / base
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"Can't make the folder {folder}: {error.strerror}. Give another --out.") from error
    chosen = chosen_views(run, count)
    views = tuple(write_views(run, chosen, folder)) if chosen else ()
    problems = [*run.problems, missing_renders(run)]
    problems += [f"frame {view.number}, {view.camera} camera: {view.problem}" for view in views if view.problem]
    no_map = f"The map in 3D is made of the first {maps} runs; --maps {place} makes it of this one too."
    if place <= maps:
        no_map = _write_map(run, folder / "map.html")
    drawn = trajectory_figure(run)
    return RunPage(
        run, label, base, views, tuple(dict.fromkeys(problem for problem in problems if problem)), no_map,
        None if drawn is None else _json(drawn),
        tuple((curve.title, _json(curve_figure(curve))) for curve in curves_of(run)),
    )  # fmt: skip


def _write_map(run: ShownRun, page: Path) -> str:
    """Write the page of the map in 3D; why that can't be done, or nothing."""
    if not isinstance(run.saved, SavedRunFolder):
        return "This run can't be read."
    try:
        trajectory = run.saved.trajectory if run.path is not None else None
        write_map_page(viewer(), shown_map(run.saved), trajectory, page)
    except BenchError as error:
        return str(error)
    return ""


def _overview(pages: Sequence[RunPage]) -> dict[str, Any]:
    """What the first page of several runs is made from."""
    runs = [page.run for page in pages]
    grouped, beside = group_runs([run.row for run in runs]), _beside(pages)
    sweeps, left_out = sweeps_of(runs)
    return {
        "pages": pages,
        "document": _each(runs),
        "hrefs": [f"{page.base}{INDEX}" for page in pages],
        "means": runs_document([run.row for run in runs]) if grouped.has_groups else None,
        "beside": _script_safe(json.dumps(beside)),
        "beside_views": [(view, len(several)) for view, several in beside.items()],
        "overlays": Choice(
            "By frame",
            "",
            tuple((title, _json(made)) for title, made in overlays(runs, [page.label for page in pages])),
        ),
        "sweeps": [(sweep, _choices(sweep), _pairs(sweep)) for sweep in sweeps],
        "left_out": left_out,
        "made": made_in_words([_with_provenance(run) for run in runs]),
        "machines": len({str(run.provenance.get("machine")) for run in runs}),
        "confidence": round(100 * CONFIDENCE),
    }


def _choices(sweep: Sweep) -> list[Choice]:
    return [
        _choice("Metric against setting", "Mean over seeds, bars: standard deviation.", against_settings(sweep)),
        _choice("Two settings", "Mean ± standard deviation over n seeds; brighter is better.", against_two(sweep)),
        _choice("Quality against time and memory", "Bars: standard deviation over seeds.", pareto(sweep)),
    ]


def _choice(title: str, caption: str, made: Iterator[Named]) -> Choice:
    shown = tuple((each.title, _json(each.figure)) for each in islice(made, MOST_FIGURES))
    return Choice(title, caption, shown, sum(1 for _ in made))


def _pairs(sweep: Sweep) -> tuple[list[Any], int]:
    pairs = list(pairs_of(sweep))
    return pairs[:MOST_FIGURES], max(0, len(pairs) - MOST_FIGURES)


def _each(runs: Sequence[ShownRun]) -> Any:
    """The table with a line for each run, and a column for each setting in which they differ."""
    grouped = group_runs([run.row for run in runs])
    settings = {run.source: row.values for row in grouped.rows for run in row.runs}
    rows = []
    for run in runs:
        differing = {column.key: settings[run.record.source].get(column.key) for column in grouped.settings}
        rows.append(replace(run.row, values=run.row.values | differing | {"seed": run.record.seed}))
    first, *others = columns_of(rows)
    return runs_document(rows, (first, *grouped.settings, Column("seed", "Seed", is_number=True), *others))


def _beside(pages: Sequence[RunPage]) -> dict[str, Any]:
    """The pictures of all runs by view, for the page to put those of one view beside each other."""
    shown: dict[str, list[dict[str, Any]]] = {}
    for page in pages:
        for view in page.views:
            files_of = {what: f"{page.base}{name}" for what, name in view.files.items()}
            psnr = None if view.psnr_db is None else f"{view.psnr_db:.2f} dB"
            named = page.name if page.label == page.name else f"{page.name}: {page.label}"
            about = {"run": plain_line(named), "psnr": psnr, "seen": view.seen, "files": files_of}
            shown.setdefault(f"{page.run.record.dataset}, {view.key}", []).append(about)
    return dict(sorted(shown.items(), key=lambda each: -len(each[1])))


def _with_provenance(run: ShownRun) -> Any:
    return replace(run.record, provenance=run.provenance)


def _details(run: ShownRun, document: Document) -> list[tuple[str, list[tuple[str, str]]]]:
    """Tables of names and values: the run's line of the table, its protocol, its provenance, all its settings."""
    record = run.record
    line, *references = (row for block in document.blocks for row in block)
    about = []
    for place, column in enumerate(document.columns):
        title = f"{column.title} {column.below}".strip()
        about.append((title, line.cells[place].text))
        about += [
            (f"{title} of a {row.names[0]}", row.cells[place].text)
            for row in references
            if column.title == "ATE" and row.cells[place].text != UNKNOWN
        ]
    return [
        ("Run", [("Folder", str(record.source)), ("Date", record.date), *about]),
        ("Protocol", _flat(record.protocol)),
        ("Provenance", _flat(run.provenance)),
        ("Settings", sorted(settings_of(portable_config(record.config)).items())),
    ]


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for key, value in values.items():
        named = f"{prefix}{key}"
        found += _flat(value, f"{named}.") if isinstance(value, Mapping) else [(named, str(value))]
    return found


def _json(made: go.Figure) -> Markup:
    """A figure as JSON that can stand in a script element."""
    return _script_safe(made.to_json())


def _script_safe(text: str) -> Markup:
    signs: Iterable[tuple[str, str]] = (("&", "\\u0026"), ("<", "\\u003c"), (">", "\\u003e"))
    for sign, escaped in signs:
        text = text.replace(sign, escaped)
    return Markup(text)


def _templates() -> jinja2.Environment:
    """Templates in which every text is escaped, and made one line of plain text before that."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.finalize = lambda value: plain_line(value) if type(value) is str else value
    return made


def _require_own(out: Path) -> None:
    """Raise ``BenchError`` where ``out`` holds something that is no report: nothing of it would be overwritten."""
    if out.exists() and not out.is_dir():
        raise BenchError(f"--out {out} is a file; give a folder.")
    if out.is_dir() and any(out.iterdir()) and not (out / _ASSETS[0]).is_file():
        raise BenchError(f"--out {out} is not empty and holds no report. Give another folder, or empty this one.")
