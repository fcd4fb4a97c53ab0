"""A sweep in figures: a metric against a setting, against two of them, and quality against time and memory."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from bench.contracts.metric import Metric
from bench.evaluation.metrics import declared_metrics
from bench.report.pages.curves import BLUE, GREY, ORANGE, figure, words
from bench.report.pages.shown_run import ShownRun
from bench.tables.collect import Row
from bench.tables.groups import STD, GroupedRuns, group_runs

MOST_FIGURES = 150
"""More of one kind than this nobody looks through; the page says how many there would be."""
_QUALITY = ("psnr_db", "heldout_psnr_db", "ssim", "lpips", "depth_l1_cm", "ate_rmse_m")
_COSTS = ("s_per_frame", "peak_memory_gb")
# What a column of the table of runs shows already, but a sweep may vary.
_TOLD = ("system", "stereo", "tracker")


@dataclass(frozen=True)
class Sweep:
    """Runs of one data set in groups that differ in settings; of each group the runs differ in their seeds alone.

    ``keys`` are the settings in which the groups differ, ``metrics`` what is known of at least two groups.
    """

    dataset: str
    groups: tuple[Row, ...]
    grouped: GroupedRuns
    keys: tuple[tuple[str, str], ...]
    metrics: tuple[Metric, ...]

    def rest(self, row: Row, without: Sequence[str]) -> str:
        """The settings of a group but those of ``without``, in words."""
        return ", ".join(f"{title}={row.values[key]}" for key, title in self.keys if key not in without)


@dataclass(frozen=True)
class Named:
    """A figure and what it is called in the list of those of its kind."""

    title: str
    figure: go.Figure


def sweeps_of(runs: Sequence[ShownRun]) -> tuple[list[Sweep], list[str]]:
    """The sweeps among the runs, one per data set with several settings, and which runs have no part in them.

    Only runs that are done and scored take part: the mean of a group is over the same frames, or not at all.
    """
    whole = [run for run in runs if run.is_whole]
    left_out = [run.record.name for run in runs if not run.is_whole]
    found = []
    for dataset in dict.fromkeys(run.record.dataset for run in whole):
        grouped = group_runs([run.row for run in whole if run.record.dataset == dataset])
        if len(grouped.rows) < 2:
            continue
        told = [(key, key) for key in _TOLD if len({row.values.get(key) for row in grouped.rows}) > 1]
        keys = (*told, *((column.key, column.title) for column in grouped.settings))
        rows = grouped.rows
        metrics = {metric.key: metric for row in rows for metric in row.own_metrics}
        metrics |= {metric.key: metric for metric in declared_metrics() if metric.column != "never"}
        known = [each for each in metrics.values() if sum(_number(row, each.key) is not None for row in rows) > 1]
        if keys and known:
            known.sort(
                key=lambda each: _QUALITY.index(each.key) if each.key in _QUALITY else len(_QUALITY) + each.order
            )
            found.append(Sweep(str(dataset), rows, grouped, keys, tuple(known)))
    return found, left_out


def against_settings(sweep: Sweep) -> Iterator[Named]:
    """Each metric against each setting, mean and standard deviation over seeds; a line for each of the other settings'
    values."""
    for metric, (key, title) in itertools.product(sweep.metrics, sweep.keys):
        made = figure(title, _named(metric), 360)
        values = _ordered(row.values.get(key) for row in sweep.groups)
        numeric = all(isinstance(_as_number(value), float) for value in values)
        for rest in dict.fromkeys(sweep.rest(row, [key]) for row in sweep.groups):
            rows = [row for row in sweep.groups if sweep.rest(row, [key]) == rest]
            rows = [row for row in rows if _number(row, metric.key) is not None]
            rows.sort(key=lambda row: values.index(row.values.get(key)))
            made.add_scatter(
                x=[_as_number(row.values.get(key)) if numeric else words(str(row.values.get(key))) for row in rows],
                y=[_number(row, metric.key) for row in rows],
                error_y={"type": "data", "array": [_spread(row, metric.key) for row in rows], "thickness": 1.2},
                name=words(rest or "mean ± std"),
                mode="lines+markers",
                text=[_in_words(row, metric) for row in rows],
                hovertemplate="%{x}: %{text}",
            )
        made.update_xaxes(type="linear" if numeric else "category")
        made.update_layout(showlegend=len(sweep.keys) > 1)
        yield Named(f"{metric.title} against {title}", made)


def against_two(sweep: Sweep) -> Iterator[Named]:
    """Each metric as a matrix of two settings; one matrix for each of the other settings' values."""
    for metric, ((key, title), (other, other_title)) in itertools.product(
        sweep.metrics, itertools.combinations(sweep.keys, 2)
    ):
        rests = dict.fromkeys(sweep.rest(row, [key, other]) for row in sweep.groups)
        for rest in rests:
            rows = [row for row in sweep.groups if sweep.rest(row, [key, other]) == rest]
            x, y = (_ordered(row.values.get(each) for row in rows) for each in (key, other))
            cells = {(row.values.get(key), row.values.get(other)): row for row in rows}
            if len(x) < 2 or len(y) < 2 or len(cells) < len(rows):
                continue
            z = [[_number(cells[a, b], metric.key) if (a, b) in cells else None for a in x] for b in y]
            text = [[_in_words(cells[a, b], metric) if (a, b) in cells else "no run" for a in x] for b in y]
            made = figure(title, other_title, 120 + 60 * len(y))
            made.add_heatmap(
                x=[words(str(a)) for a in x], y=[words(str(b)) for b in y], z=z, text=text, texttemplate="%{text}",
                colorscale="Viridis", reversescale=metric.better == "lower",
                colorbar={"title": {"text": words(_named(metric))}, "thickness": 12, "outlinewidth": 0},
                hovertemplate="%{x}, %{y}: %{text}<extra></extra>",
            )  # fmt: skip
            made.update_xaxes(type="category")
            made.update_yaxes(type="category")
            yield Named(f"{metric.title}: {title} and {other_title}{f' ({rest})' if rest else ''}", made)


def pareto(sweep: Sweep) -> Iterator[Named]:
    """Quality against time and memory: the groups, and through those that no other one beats in both a line."""
    by_key = {metric.key: metric for metric in sweep.metrics}
    for quality, cost in itertools.product(_QUALITY, _COSTS):
        if quality not in by_key or cost not in by_key:
            continue
        good, cheap = by_key[quality], by_key[cost]
        rows = [row for row in sweep.groups if None not in (_number(row, quality), _number(row, cost))]
        if len(rows) < 2:
            continue
        points = np.array([[_number(row, cost), _number(row, quality)] for row in rows], dtype=np.float64)
        best = unbeaten(points * [1.0, -1.0 if good.better == "higher" else 1.0])
        made = figure(_named(cheap), _named(good), 400)
        front = points[best][np.argsort(points[best][:, 0], kind="stable")]
        made.add_scatter(x=front[:, 0], y=front[:, 1], mode="lines", showlegend=False, hoverinfo="skip",
                         line={"color": ORANGE, "width": 1.5, "dash": "dot"})  # fmt: skip
        for name, chosen, color in (("beaten by none in both", best, ORANGE), ("others", ~best, GREY)):
            several = [row for row, is_one in zip(rows, chosen, strict=True) if is_one]
            made.add_scatter(
                x=points[chosen][:, 0], y=points[chosen][:, 1], mode="markers", name=name,
                error_x={"type": "data", "array": [_spread(row, cost) for row in several], "thickness": 1},
                error_y={"type": "data", "array": [_spread(row, quality) for row in several], "thickness": 1},
                marker={"size": 9, "color": color, "line": {"width": 1, "color": BLUE}},
                text=[words(sweep.grouped.label(row)) for row in several],
                hovertemplate="%{text}: %{x}, %{y}<extra></extra>",
            )  # fmt: skip
        yield Named(f"{good.title} against {cheap.title.lower()}", made)


def unbeaten(costs: np.ndarray) -> np.ndarray:
    """Which of the points (N, 2), smaller being better, no other one beats: as good in both and better in one."""
    as_good = (costs[:, None] <= costs[None]).all(axis=2)
    better = (costs[:, None] < costs[None]).any(axis=2)
    return np.asarray(~(as_good & better).any(axis=0))


def _named(metric: Metric) -> str:
    return f"{metric.title} [{metric.unit}]" if metric.unit else metric.title


def _number(row: Row, key: str) -> float | None:
    value = row.values.get(key)
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


def _spread(row: Row, key: str) -> float:
    """Standard deviation over the group's seeds; 0 draws nothing, where there is one seed."""
    return float(row.values.get(f"{key}{STD}") or 0.0)


def _in_words(row: Row, metric: Metric) -> str:
    value, digits = _number(row, metric.key), 0 if metric.decimals is None else metric.decimals
    if value is None:
        return "no value"
    n = sum(run.values.get(metric.key) is not None for run in row.runs)
    return f"{value:,.{digits}f}" + (f" ± {_spread(row, metric.key):,.{digits}f} (n={n})" if n > 1 else "")


def _as_number(value: object) -> float | str:
    try:
        return float(str(value))
    except ValueError:
        return str(value)


def _ordered(values: Iterator[object]) -> list[object]:
    """Different values, numbers by size before words."""
    numbered = {value: _as_number(value) for value in values}
    return sorted(numbered, key=lambda each: (isinstance(numbered[each], str), numbered[each]))
