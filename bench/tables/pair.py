"""Two runs beside each other: settings that differ, metrics, frames; and why their numbers can't be compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from bench.contracts.metric import Metric
from bench.errors import BenchError, require_choice
from bench.evaluation.metrics import declared_metrics
from bench.io.csv_files import read_csv
from bench.io.frame_range import describe
from bench.registry import RUN_KINDS
from bench.runs.folder import CHECKSUM_COLUMN, FRAME_COLUMNS, FRAMES_FILE, PER_FRAME_FILE
from bench.tables.records.record import RunRecord
from bench.tables.records.settings import Settings, differing_keys, scored_config, settings_of

_MOST_FRAMES = 10
_OF_RIGHT_VIEWS = "right_images_mapped"
"""The one part of a protocol's stamp that says which right views count and nothing of the others."""
_PER_FRAME = (
    *(Metric("ate_m", "position error", "m", "lower", 3), Metric("rpe_trans_m", "RPE", "m", "lower", 4)),
    Metric("rpe_rot_deg", "RPE rotation", "deg", "lower", 3),
)
"""Columns of ``per_frame.csv`` that are no metric's key."""


@dataclass(frozen=True)
class MetricPair:
    """A metric of both runs; ``better`` is "A", "B", "" (equal, or its better direction is not known)."""

    metric: Metric
    a: float
    b: float
    better: str


@dataclass(frozen=True)
class FramesPair:
    """A metric per frame of the views of one camera: in how many A is better, B is better, and they are equal.

    ``largest``: the (at most ten) frames with the largest difference: number, value of A, value of B.
    """

    metric: Metric
    camera: str
    a_better: int
    b_better: int
    equal: int
    largest: tuple[tuple[int, float, float], ...]


def differing_settings(a: RunRecord, b: RunRecord) -> list[tuple[str, str | None, str | None]]:
    """Dotted name and both values (None: it has no such setting) of what differs, the seed and the sequence too.

    Of a part that is another plugin in each run only the plugin's name is given: its settings are others anyway.
    """
    settings = [_all_settings(run) for run in (a, b)]
    keys = differing_keys(settings)
    other = {kind for kind in RUN_KINDS if f"{kind}.name" in keys}
    shown = [key for key in keys if key.partition(".")[0] not in other or key.partition(".")[2] == "name"]
    return [(key, settings[0].get(key), settings[1].get(key)) for key in shown]


def why_not_comparable(a: RunRecord, b: RunRecord) -> list[str]:
    """What of the data, the protocol and the frames done differs, in words; empty where numbers can be compared.

    Raises ``BenchError`` for a damaged run.
    """
    for run in (a, b):
        if run.damage:
            raise BenchError(run.damage[0])
    reasons = [f"data: {key} {x} and {y}" for key, x, y in differing_settings(a, b) if key.startswith("dataset.")]
    both = sorted((a.protocol.keys() | b.protocol.keys()) - {"name", _OF_RIGHT_VIEWS})
    if a.protocol and b.protocol:
        told = [(key, a.protocol.get(key), b.protocol.get(key)) for key in both]
        reasons += [f"protocol: {key} {x} and {y}" for key, x, y in told if x != y]
    if a.frames != b.frames:
        reasons.append(f"frames done: {a.frames} and {b.frames}")
    checksums = [_checksums(run) for run in (a, b)]
    changed = [n for n, known in checksums[0].items() if checksums[1].get(n, known) != known]
    if changed and not reasons:
        reasons.append(f"data: the images of {describe(changed)} are not the same")
    return reasons


def metric_pairs(a: RunRecord, b: RunRecord) -> list[MetricPair]:
    """Of each metric that both runs have, in the order of tables; right views only where both score the same ones."""
    metrics = {metric.key: metric for metric in (*declared_metrics(), *a.own_metrics, *b.own_metrics)}
    same_right = a.protocol.get(_OF_RIGHT_VIEWS) == b.protocol.get(_OF_RIGHT_VIEWS)
    found = []
    for metric in sorted(metrics.values(), key=lambda each: each.order):
        if not same_right and metric.path.startswith("views.right."):
            continue
        x, y = (_value(metric, run) for run in (a, b))
        if x is not None and y is not None:
            found.append(MetricPair(metric, x, y, _better(metric, x, y)))
    return found


def frame_pairs(a: RunRecord, b: RunRecord, by: str) -> list[FramesPair]:
    """Of each camera, how the metric ``by`` (a column of ``per_frame.csv``) compares in the frames where both have it.

    Raises ``BenchError`` where a run has no such file, or ``by`` is no metric whose better direction is known.
    """
    known = {metric.key: metric for metric in (*declared_metrics(), *_PER_FRAME) if metric.better is not None}
    tables = [read_csv(run.source / PER_FRAME_FILE, ("view", "number")) for run in (a, b)]
    columns = [column for column in tables[0] if column in tables[1] and column in known]
    metric = known[require_choice("--by", by, columns)]
    merged = tables[0].merge(tables[1], on=["view", "number"], suffixes=("", " of B")).dropna(subset=[by, f"{by} of B"])
    same_right = a.protocol.get(_OF_RIGHT_VIEWS) == b.protocol.get(_OF_RIGHT_VIEWS)
    return [
        _of_camera(metric, str(camera), of_camera)
        for camera, of_camera in merged.groupby("view")
        if same_right or camera != "right"
    ]


def _of_camera(metric: Metric, camera: str, frames: pd.DataFrame) -> FramesPair:
    x, y = frames[metric.key], frames[f"{metric.key} of B"]
    better = [_better(metric, *pair) for pair in zip(x, y, strict=True)]
    order = (x - y).abs().sort_values(ascending=False, kind="stable").index
    largest = [row for row in order[:_MOST_FRAMES] if x[row] != y[row]]
    return FramesPair(
        metric,
        camera,
        better.count("A"),
        better.count("B"),
        better.count(""),
        tuple((int(frames["number"][row]), float(x[row]), float(y[row])) for row in largest),
    )


def _all_settings(run: RunRecord) -> Settings:
    """``settings_of``, and what it leaves out because runs of a table may differ in it: seed and sequence."""
    dataset = run.config.get("dataset")
    sequence = dataset.get("sequence") if isinstance(dataset, Mapping) else None
    left_out: dict[str, Any] = {"seed": run.config.get("seed"), "dataset.sequence": sequence}
    settings = settings_of(scored_config(run))
    return settings | {key: str(value) for key, value in left_out.items() if value is not None}


def _value(metric: Metric, run: RunRecord) -> float | None:
    value = metric.value_in(run.metrics)
    return metric.value_in(run.measured) if value is None else value


def _better(metric: Metric, a: float, b: float) -> str:
    if a == b or metric.better is None:
        return ""
    return "A" if (a > b) == (metric.better == "higher") else "B"


def _checksums(run: RunRecord) -> dict[int, int]:
    """Of the images that the run read, by frame number; empty where it kept none."""
    if not (run.source / FRAMES_FILE).is_file():
        return {}
    frames = read_csv(run.source / FRAMES_FILE, FRAME_COLUMNS)
    if CHECKSUM_COLUMN not in frames:
        return {}
    return dict(zip(frames["number"].tolist(), frames[CHECKSUM_COLUMN].tolist(), strict=True))
