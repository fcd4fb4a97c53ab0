"""Plotly figures of runs: the trajectory from above, and what was measured frame by frame."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from bench.evaluation.relative_motion import index_in_estimate
from bench.plain_text import plain_line
from bench.report.pages.shown_run import ShownRun, values_of
from bench.types import Float

BLUE, ORANGE, GREEN, PURPLE, GREY = "#3f83c9", "#d8732c", "#35976a", "#a95fa0", "#8a8a8a"
# Of each frame, what is drawn over all runs: column of per_frame.csv (left views), heading, unit.
SCORES = (
    ("psnr_db", "PSNR", "dB"),
    ("depth_l1_cm", "Depth-L1", "cm"),
    ("ate_m", "Error of position", "m"),
)


@dataclass(frozen=True)
class Curve:
    """Values by frame number, in a figure with this heading and unit."""

    title: str
    unit: str
    series: Mapping[str, pd.Series]
    points: frozenset[str] = frozenset()
    """Names of the series that are drawn as points: frames between them are of another series."""


def words(text: str) -> str:
    """Text for a figure, in which plotly would take tags and entities for what they are."""
    return html.escape(plain_line(text, 200), quote=False)


def figure(x: str, y: str, height: int = 300) -> go.Figure:
    """An empty figure; its colours of text and grid are the page's."""
    made = go.Figure()
    made.update_layout(
        template=go.layout.Template(),
        height=height,
        margin={"l": 58, "r": 12, "t": 12, "b": 44},
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        xaxis_title=words(x),
        yaxis_title=words(y),
    )
    return made


def curves_of(run: ShownRun) -> list[Curve]:
    """What the run knows frame by frame; a curve without any value is left out."""
    frames = run.frames
    if frames.empty:
        return []
    mapped, heldout = (frames.loc[frames[name], "number"].tolist() for name in ("mapped", "heldout"))
    rest = [number for number in frames["number"] if number not in {*mapped, *heldout}]
    found = []
    for column, title, unit in SCORES[:2]:
        series = {
            # Lost frames, which have no value, break the line; held-out frames between two others do not.
            "mapped views": values_of(run, "left", column, mapped).reindex(sorted([*mapped, *rest])),
            "held-out views, unseen": values_of(run, "left", column, heldout),
            "views not mapped": values_of(run, "left", column, rest),
            "right camera": values_of(run, "right", column).reindex(frames["number"]),
        }
        found.append(Curve(title, unit, series, frozenset(("held-out views, unseen", "views not mapped"))))
    if not run.record.is_scored and "psnr_while_mapping" in frames:
        found.append(Curve("PSNR while mapping, no score", "dB", {"mapped views": _column(run, "psnr_while_mapping")}))
    position = values_of(run, "left", "ate_m").reindex(frames["number"])
    found.append(Curve("Error of position", "m", {"left camera": position}))
    found.append(Curve("Time per frame", "s", times_of(run)))
    found.append(Curve("Memory of the process", "GB", {"memory": _column(run, "memory_gb").dropna()}))
    found.append(Curve("Gaussians", "", {"Gaussians": _column(run, "gaussians").dropna()}))
    return [curve for curve in found if any(series.notna().any() for series in curve.series.values())]


def times_of(run: ShownRun) -> dict[str, pd.Series]:
    """Seconds of each part by frame; of what came from the disk cache, which the name tells, those of computing it."""
    found = {}
    for name in ("tracking", "stereo", "mapping"):
        cached = f"{name}_cached"
        kept = cached in run.frames and is_yes(run.frames[cached]).any()
        found[f"{name}, as cached" if kept else name] = _column(run, f"{name}_s")
    return found


def curve_figure(curve: Curve) -> go.Figure:
    """The figure of one curve; lines break where a frame has no value."""
    made = figure("frame", f"{curve.title} [{curve.unit}]" if curve.unit else curve.title)
    named = [(name, series) for name, series in curve.series.items() if series.notna().any()]
    for color, (name, series) in zip((BLUE, ORANGE, PURPLE, GREEN), named, strict=False):
        made.add_scatter(
            x=series.index.to_numpy(dtype=np.int64),
            y=series.to_numpy(dtype=np.float32),
            name=name,
            mode="markers" if name in curve.points else "lines",
            marker={"size": 7, "symbol": "diamond-open", "color": color},
            line={"width": 1.5, "color": color},
        )
    made.update_layout(showlegend=len(named) > 1)
    return made


def overlay_figure(title: str, unit: str, series: Sequence[tuple[str, pd.Series]]) -> go.Figure:
    """One value of all runs by frame, a line each."""
    made = figure("frame", f"{title} [{unit}]" if unit else title, 380)
    for name, values in series:
        x = values.index.to_numpy(dtype=np.int64)
        made.add_scatter(x=x, y=values.to_numpy(dtype=np.float32), name=words(name), mode="lines", line={"width": 1.5})
    made.update_layout(legend={"orientation": "v", "y": 1, "yanchor": "top", "x": 1.01, "font": {"size": 10}})
    return made


def overlays(runs: Sequence[ShownRun], names: Sequence[str]) -> list[tuple[str, go.Figure]]:
    """For each value that some run has by frame, its heading and the figure with all runs that have it."""
    found: list[tuple[str, str, list[pd.Series]]] = [
        (title, unit, [values_of(run, "left", column) for run in runs]) for column, title, unit in SCORES
    ]
    found.append(("Mapping time", "s", [_column(run, "mapping_s") for run in runs]))
    found.append(("Memory of the process", "GB", [_column(run, "memory_gb") for run in runs]))
    found.append(("Gaussians", "", [_column(run, "gaussians").dropna() for run in runs]))
    made = []
    for title, unit, several in found:
        series = [(name, values) for name, values in zip(names, several, strict=True) if values.notna().any()]
        if series:
            made.append((title, overlay_figure(title, unit, series)))
    return made


def trajectory_figure(run: ShownRun) -> go.Figure | None:
    """x and z of the camera centres in the ground truth's world, in metres, coloured by the error of position.

    Keyframes are rings, closed loops lines between their frames, lost frames crosses on the ground truth. None where
    the run has no trajectory to draw.
    """
    if run.path is None:
        return None
    made = figure("x [m]", "z [m]", 520)
    made.update_yaxes(scaleanchor="x", scaleratio=1)
    estimate, truth = run.path.estimate, run.path.truth
    if truth is not None:
        made.add_scatter(
            **_xz(truth.T_world_cam[:, :3, 3]), name="ground truth", mode="lines", line={"color": GREY, "width": 5},
            opacity=0.45, text=truth.numbers, hovertemplate="frame %{text}",
        )  # fmt: skip
    if run.path.ate is None:
        made.add_scatter(
            **_xz(estimate.T_world_cam[:, :3, 3]), name="estimate, no errors known", mode="lines",
            text=estimate.numbers, line={"color": BLUE, "width": 1.5}, hovertemplate="frame %{text}",
        )  # fmt: skip
    else:
        _add_errors(made, run)
    if truth is not None and (lost := index_in_estimate(estimate, truth) < 0).any():
        made.add_scatter(
            **_xz(truth.T_world_cam[lost, :3, 3]), name=f"lost, {int(lost.sum())} frames", mode="markers",
            marker={"symbol": "x", "color": "#d03b3b", "size": 6}, text=truth.numbers[lost],
            hovertemplate="frame %{text}",
        )  # fmt: skip
    _add_keyframes(made, run)
    for place, (frame, to) in enumerate(run.loops):
        ends = [estimate.pose_of(number) for number in (frame, to)]
        if any(end is None for end in ends):
            continue
        made.add_scatter(
            **_xz(np.stack([end[:3, 3] for end in ends if end is not None])), mode="lines+markers",
            name=f"closed loops, {len(run.loops)}", legendgroup="loops", showlegend=place == 0,
            line={"color": PURPLE, "width": 2, "dash": "dot"}, marker={"symbol": "star", "size": 9},
            hovertemplate=f"loop from frame {frame} to frame {to}",
        )  # fmt: skip
    return made


def _add_errors(made: go.Figure, run: ShownRun) -> None:
    assert run.path is not None
    assert run.path.ate is not None
    ate = run.path.ate
    centres = ate.aligned.T_world_cam[np.searchsorted(ate.aligned.numbers, ate.numbers), :3, 3]
    made.add_scatter(
        **_xz(centres),
        name=f"estimate, {ate.n} frames",
        mode="markers",
        marker={
            "color": ate.errors_m.astype(np.float32),
            "colorscale": "Viridis",
            "cmin": 0,
            "size": 5,
            "colorbar": {"title": {"text": "error [m]"}, "thickness": 12, "outlinewidth": 0},
        },
        text=[f"frame {number}: {error:.3f} m" for number, error in zip(ate.numbers, ate.errors_m, strict=True)],
        hovertemplate="%{text}",
    )


def _add_keyframes(made: go.Figure, run: ShownRun) -> None:
    if "is_keyframe" not in run.frames:
        return
    assert run.path is not None
    keyframes = run.path.estimate.of_frames(run.frames.loc[is_yes(run.frames["is_keyframe"]), "number"].tolist())
    if len(keyframes):
        made.add_scatter(
            **_xz(keyframes.T_world_cam[:, :3, 3]), name=f"keyframes, {len(keyframes)}", mode="markers",
            marker={"symbol": "circle-open", "size": 9, "color": ORANGE}, text=keyframes.numbers,
            hovertemplate="keyframe %{text}",
        )  # fmt: skip


def _xz(centres: Float) -> dict[str, Float]:
    return {"x": centres[:, 0], "y": centres[:, 2]}


def is_yes(column: pd.Series) -> pd.Series:
    """Which cells of a CSV file say yes; an empty one does not."""
    return column.astype(str).str.lower().isin(["true", "1", "1.0"])


def _column(run: ShownRun, name: str) -> pd.Series:
    """A column of the run's frames by their numbers, NaN where it has no value; empty where there is no such column."""
    if name not in run.frames:
        return pd.Series(dtype=np.float64)
    return run.frames.drop_duplicates("number").set_index("number")[name]
