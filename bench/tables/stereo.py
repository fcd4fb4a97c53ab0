"""The table of stereo backbones: each scored as stereo, beside what SLAM made of it."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.evaluation.disparity import DisparityScore
from bench.evaluation.stereo_backbone import BackboneScore
from bench.evaluation.stereo_process import Broken
from bench.tables.collect import Column, Row, row_of
from bench.tables.records.folder import read_run
from bench.tables.records.record import RunRecord

# Of a run's row, what is shown beside the score of its backbone.
_SLAM_COLUMNS = (
    Column("psnr_db", "SLAM PSNR", "dB", 2, optional=True),
    Column("heldout_psnr_db", "SLAM held-out PSNR", "dB", 2, optional=True),
    Column("lpips", "SLAM LPIPS", "", 3, optional=True),
    Column("depth_l1_cm", "SLAM Depth-L1", "cm", 1, optional=True),
    Column("s_per_frame", "SLAM time", "s/frame", 2, optional=True),
)

STEREO_COLUMNS = (
    Column("stereo", "Stereo"),
    Column("dataset", "Dataset"),
    Column("status", "Status"),
    Column("epe_px", "EPE", "px", 3),
    Column("bad1_percent", "bad-1", "%", 2),
    Column("bad2_percent", "bad-2", "%", 2),
    Column("bad3_percent", "bad-3", "%", 2),
    Column("d1_percent", "D1", "%", 2),
    Column("density_percent", "Density", "%", 1),
    Column("epe_all_px", "EPE-all", "px", 3),
    Column("d1_all_percent", "D1-all", "%", 2),
    Column("d1_all_image_mean_percent", "D1-all, mean of images", "%", 2),
    Column("holes_percent", "Holes", "%", 1),
    Column("ms_per_frame", "Time", "ms", 0),
    Column("peak_memory_gb", "Memory", "GB", 2),
    *_SLAM_COLUMNS,
)

IMAGE_COLUMNS = ("stereo", "dataset", "number", "truth_pixels", "epe_px", "bad1_percent", "bad2_percent",
                 "bad3_percent", "d1_percent", "density_percent", "epe_all_px", "d1_all_percent", "holes_percent",
                 "ms")  # fmt: skip


@dataclass(frozen=True)
class Scored:
    """One backbone: how the table calls it and its data set, its settings, and its score, or why it has none."""

    label: str
    dataset: str
    stereo: dict[str, Any]
    outcome: BackboneScore | Broken


def stereo_rows(scored: Sequence[Scored], runs: Sequence[Path] = ()) -> list[Row]:
    """One row per backbone, with the means over the runs that used it; then one per backbone that only runs know.

    A run belongs to the rows with exactly its stereo settings, else to those with the same plugin, if all of these have
    the same settings.
    """
    found: dict[int, list[RunRecord]] = {}
    others: dict[str, list[RunRecord]] = {}
    for run in map(read_run, runs):
        stereo = run.config.get("stereo")
        used = stereo if isinstance(stereo, dict) else {}
        places = _places_of(used, scored)
        for place in places:
            found.setdefault(place, []).append(run)
        if not places:
            others.setdefault(str(used.get("name", "unknown")), []).append(run)
    rows = [_with_slam(_row(one), found.get(place, [])) for place, one in enumerate(scored)]
    for name, known in others.items():
        rows.append(_with_slam(Row({"run": name, "stereo": name, "status": "not scored as stereo"}), known))
    return rows


def image_table(scored: Sequence[Scored]) -> list[dict[str, Any]]:
    """One row per image and backbone, with the keys ``IMAGE_COLUMNS``; broken backbones have none."""
    rows = []
    for one in scored:
        for image in one.outcome.images if isinstance(one.outcome, BackboneScore) else ():
            values: dict[str, Any] = {"stereo": one.label, "dataset": one.dataset, "number": image.number}
            values |= {"truth_pixels": image.score.interpolated.pixels, "ms": image.ms} | _figures(image.score)
            rows.append({key: values[key] for key in IMAGE_COLUMNS})
    return rows


def _figures(score: DisparityScore) -> dict[str, float | None]:
    bad1, bad2, bad3 = score.filled.bad_percent
    return {
        "epe_px": score.filled.epe_px,
        "bad1_percent": bad1,
        "bad2_percent": bad2,
        "bad3_percent": bad3,
        "d1_percent": score.filled.d1_percent,
        "density_percent": score.density_percent,
        "epe_all_px": score.interpolated.epe_px,
        "d1_all_percent": score.interpolated.d1_percent,
        "holes_percent": score.holes_percent,
    }


def _row(one: Scored) -> Row:
    values: dict[str, Any] = {"run": one.label, "stereo": one.label, "dataset": one.dataset}
    if isinstance(one.outcome, Broken):
        return Row(values | {"status": "failed"}, notes=(one.outcome.reason,))
    outcome = one.outcome
    values |= {"status": "done"} | dict(_figures(outcome.pooled))
    values["d1_all_image_mean_percent"] = outcome.image_mean(lambda score: score.interpolated.d1_percent)
    values |= {"ms_per_frame": outcome.median_ms, "peak_memory_gb": outcome.peak_memory_gb}
    stamp = {
        "name": "stereo",
        "truth": outcome.truth,
        "images": len(outcome.images),
        "averaging": "pooled over the pixels of all images, time the median image's",
        "holes": "left out, but in EPE-all and D1-all, which fill them from the background",
    }
    return Row(values, stamp)


def _places_of(used: dict[str, Any], scored: Sequence[Scored]) -> list[int]:
    exact = [place for place, one in enumerate(scored) if one.stereo == used]
    if exact:
        return exact
    alike = [place for place, one in enumerate(scored) if one.stereo["name"] == used.get("name")]
    return alike if all(scored[place].stereo == scored[alike[0]].stereo for place in alike) else []


def _with_slam(row: Row, runs: Sequence[RunRecord]) -> Row:
    """The row with the means over the runs of what they measured, and a note that names them and their data sets."""
    if not runs:
        return row
    collected = [row_of(run) for run in runs]
    values: dict[str, float] = {}
    for column in _SLAM_COLUMNS:
        known = [value for one in collected if isinstance(value := one.values.get(column.key), (int, float))]
        if known:
            values[column.key] = statistics.fmean(known)
    names = ", ".join(f"{one.values['run']} on {one.values['dataset']}" for one in collected)
    note = f"SLAM: {'mean of the runs' if len(runs) > 1 else 'run'} {names}"
    return replace(row, values=row.values | values, notes=(*row.notes, note))
