"""The tables of README.md and docs/: from which kept files, with which rows, columns and labels."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

from bench.errors import BenchError
from bench.installed_data import published_folder
from bench.runs.status import read_json
from bench.tables.named.published import read_published
from bench.tables.named.table import make_table
from bench.tables.records.file import SUFFIX
from bench.tables.records.record import RunRecord
from tools.doc_tables import performance
from tools.doc_tables.blocks import Block
from tools.doc_tables.columns import (
    FixedRow,
    RunColumn,
    Runs,
    by_settings,
    figures,
    link,
    made_by,
    median,
    number,
    read_kept,
    run_table,
    text_table,
)
from tools.doc_tables.gpu import gpu_table

_STAGES = "+".join(f"resources.{stage}_s_per_frame" for stage in ("tracking", "stereo", "mapping"))

_SETTINGS = (
    "system=bgs_slam",
    "system=bgs_slam_fast",
    "system=bgs_slam_best",
    "system=bgs_slam stereo=lidar",
    "system=bgs_slam_paper",
    "system=bgs_slam_letter",
    "system=bgs_slam_letter stereo=lidar",
)
_MEASURED = (
    RunColumn("PSNR dB", figures("{:.2f}", "views.train.psnr_db")),
    RunColumn("SSIM", figures("{:.3f}", "views.train.ssim")),
    RunColumn("LPIPS", figures("{:.3f}", "views.train.lpips")),
    RunColumn("held-out dB", figures("{:.2f}", "views.heldout.psnr_db")),
    RunColumn("held-out SSIM", figures("{:.3f}", "views.heldout.ssim")),
    RunColumn("right dB", figures("{:.2f}", "views.right.psnr_db")),
    RunColumn("right SSIM", figures("{:.3f}", "views.right.ssim")),
    RunColumn("Depth-L1 cm", figures("{:.0f}", "views.left.depth_l1_cm")),
    RunColumn("ATE m", figures("{:.3f}", "trajectory.ate_rmse_m")),
    RunColumn("Gaussians k", figures("{:.0f}", "map.gaussians", scale=1e-3)),
    RunColumn("memory GB", figures("{:.2f}", "resources.peak_memory_gb")),
    RunColumn("stages s", figures("{:.2f}", _STAGES)),
    RunColumn("wall s", figures("{:.2f}", "resources.wall_s_per_frame")),
)

# Columns and rows of the short table.
_SHORT = {
    "SETTINGS": "",
    **{
        name: name
        for name in ("PSNR dB", "SSIM", "LPIPS", "held-out dB", "held-out SSIM", "Depth-L1 cm", "ATE m", "memory GB")
    },
    "wall s": "s per frame",
}
_SHORT_ROWS = (
    *("`system=bgs_slam_fast`", "`system=bgs_slam`", "`system=bgs_slam_best`", "`system=bgs_slam_paper`"),
    "*paper, BGS-SLAM, sequence 06*",
)


def _measured(kept: Path, folder: Path) -> str:
    """KITTI 06: a row for each of ``_SETTINGS``, then the paper's two."""
    file = kept / f"kitti06{SUFFIX}"
    runs = read_kept(file)
    members = by_settings(runs, _SETTINGS)
    names = {id(run): f"`{row}`" for row, found in members.items() for run in found}
    columns = (RunColumn("SETTINGS", lambda of_row: names[id(of_row[0])]), *_MEASURED)
    rows: list[Runs | FixedRow] = [members[row] for row in _SETTINGS if members[row]]
    rows += [_of_the_paper("BGS-SLAM (Ours)", "BGS-SLAM"), _of_the_paper("BGS-SLAM (LiDAR)", "BGS-SLAM (LiDAR)")]
    return f"{run_table(columns, rows)}\n\n{made_by(runs, file, folder)}"


def _measured_short(kept: Path, folder: Path) -> str:
    """The rows of ``_measured`` for three presets and the paper, in figures that need no explanation."""
    whole = _measured(kept, folder)
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in whole.splitlines() if line.startswith("|")]
    head, _, *body = rows
    shown = [head.index(name) for name in _SHORT]
    body = [row for row in body if row[0] in _SHORT_ROWS]
    return text_table([_SHORT[head[at]] for at in shown], [[row[at] for at in shown] for row in body])


def _of_the_paper(method: str, label: str) -> FixedRow:
    """What the paper has of a method on sequence 06."""
    tables = ("main_kitti", "memory", "runtime")
    values = [
        value
        for table in tables
        for value in read_published(published_folder() / f"{table}.csv", table)
        if value.method == method
    ]
    by_metric = {value.metric: value.value for value in values if value.sequence in ("06", "average")} | {
        value.metric: value.value for value in values if value.sequence == "06"
    }
    keys = ("tracking_s_per_frame", "mapping_s_per_frame")
    stages = [float(value) for key in keys if (value := by_metric.get(key))]
    cells = [
        f"paper, {label}, sequence 06",
        *(by_metric[key] for key in ("psnr_db", "ssim", "lpips")),
        *("", "", "", ""),
        f"{float(by_metric['depth_l1_cm']):.0f}",
        by_metric["ate_rmse_m"],
        "",
        by_metric.get("peak_memory_gb") or "",
        f"{sum(stages):.2f}" if len(stages) == len(keys) else "",
        "",
    ]
    return FixedRow(tuple(f"*{cell}*" if cell else "" for cell in cells))


_TRACKER_ROWS: tuple[tuple[str, str, str, float], ...] = (
    ("t_rel over 10-50 m, %", "trajectory.t_rel_short_percent", "{:.3f}", 1.0),
    ("ATE, m", "trajectory.ate_rmse_m", "{:.3f}", 1.0),
    ("RPE, mean, mm", "trajectory.rpe_trans_mean_m", "{:.1f}", 1e3),
    ("RPE, RMSE, mm", "trajectory.rpe_trans_rmse_m", "{:.1f}", 1e3),
    ("time per frame, s", "resources.tracking_s_per_frame", "{:.3f}", 1.0),
)


def _trackers(kept: Path, folder: Path) -> str:
    """Medians of the runs of two trackers on the same frames, and how much the first has of the second's."""
    file = kept / f"trackers{SUFFIX}"
    runs = read_kept(file)
    members = by_settings(runs, ("tracker=stereo_orb", "tracker=orbslam3"))
    if not all(members.values()):
        raise BenchError(f"{file} needs runs of both trackers, stereo_orb and orbslam3. Keep both sweeps' runs.")
    rows = []
    for label, path, form, scale in _TRACKER_ROWS:
        ours, theirs = (median(found, path) * scale for found in members.values())
        rows.append([label, form.format(ours), form.format(theirs), f"{ours / theirs:.2f}"])
    counts = " and ".join(str(len(found)) for found in members.values())
    table = text_table(["", "stereo_orb", "ORB-SLAM3", "ratio"], rows)
    return f"{table}\n\nMedians of {counts} runs. {made_by(runs, file, folder)}"


def _circuits(kept: Path, folder: Path) -> str:
    """One row a street, by its seed: ATE, the loops that were closed, lost frames."""
    file = kept / f"circuits{SUFFIX}"
    runs = sorted(read_kept(file), key=_street)
    columns = (
        RunColumn("dataset.seed", lambda of_row: str(_street(of_row[0]))),
        RunColumn("ATE [m]", figures("{:.3f}", "trajectory.ate_rmse_m")),
        RunColumn("loops closed: frame → frame", lambda of_row: _loops(of_row[0])),
        RunColumn("frames", figures("{:.0f}", "frames.total")),
        RunColumn("frames lost", figures("{:.0f}", "frames.lost")),
    )
    errors = [error for run in runs if (error := number(run, "trajectory.ate_rmse_m")) is not None]
    mean = f"Mean ATE {sum(errors) / len(errors):.3f} m. " if errors else ""
    return f"{run_table(columns, [[run] for run in runs])}\n\n{mean}{made_by(runs, file, folder)}"


_STREETS = {
    "as it is": "dataset.texture=1 dataset.light=1 dataset.shutter=0",
    "plain": "dataset.texture=0.1",
    "dark": "dataset.light=0.1",
    "blurred": "dataset.shutter=0.5",
}


def _found(of_row: Runs) -> str:
    """Numbers of frames by state; of a run that came to nothing, why."""
    return figures("{:.0f} / {:.0f} / {:.0f}", "frames.ok", "frames.weak", "frames.lost")(of_row) or "; ".join(
        run.reason.partition(":")[0] for run in of_row
    )


_FEATURES = (
    RunColumn("frames ok / weak / lost", _found),
    RunColumn("ATE [m]", figures("{:.3f}", "trajectory.ate_rmse_m")),
    RunColumn("RPE [mm]", figures("{:.1f}", "trajectory.rpe_trans_rmse_m", scale=1e3)),
    RunColumn("ms per frame", figures("{:.0f}", "resources.tracking_s_per_frame", scale=1e3)),
)


def _features(kept: Path, folder: Path) -> str:
    """ORB and XFeat on every kind of street: how many frames were found, how well, and in what time."""
    file = kept / f"features{SUFFIX}"
    runs = read_kept(file)
    rows = {
        f"{overrides} tracker.features={features}": (street, features)
        for street, overrides in _STREETS.items()
        for features in ("orb", "xfeat")
    }
    found = by_settings(runs, list(rows))
    lines = [[*rows[row], *(column.text(members) for column in _FEATURES)] for row, members in found.items()]
    table = text_table(["street", "features", *(column.heading for column in _FEATURES)], lines)
    return f"{table}\n\n{made_by(runs, file, folder)}"


def _street(run: RunRecord) -> int:
    return int(run.config["dataset"]["seed"])


def _loops(run: RunRecord) -> str:
    loops = run.provenance.get("loops_closed", [])
    return ", ".join(f"{new} → {old}" for new, old in loops) or "none"


_STEREO_COLUMNS = (
    ("EPE [px]", "epe_px", "{:.2f}"),
    ("D1 [%]", "d1_percent", "{:.1f}"),
    ("filled [%]", "density_percent", "{:.0f}"),
    ("ms per pair", "ms_per_frame", "{:.0f}"),
    ("PSNR [dB]", "psnr_db", "{:.2f}"),
    ("held-out [dB]", "heldout_psnr_db", "{:.2f}"),
    ("LPIPS", "lpips", "{:.3f}"),
    ("Depth-L1 [cm]", "depth_l1_cm", "{:.0f}"),
    ("s per frame", "s_per_frame", "{:.2f}"),
)
_STEREO_NAMES = {"onnx": "onnx stereo.preset=nvtiny"}


def _stereo(kept: Path, folder: Path) -> str:
    """Stereo backbones by themselves and in the system, as `bgs-bench stereo-eval --runs --out` wrote them."""
    file = kept / "stereo_kitti06.csv"
    with file.open(newline="", encoding="utf-8") as opened:
        rows = list(csv.DictReader(opened))
    lines = []
    for row in rows:
        cells = [f"`{_STEREO_NAMES.get(row['stereo'], row['stereo'])}`"]
        for _, key, form in _STEREO_COLUMNS:
            value = row.get(key, "")
            cells.append(form.format(float(value)) if value else "")
        lines.append(cells)
    table = text_table(["stereo", *(heading for heading, _, _ in _STEREO_COLUMNS)], lines)
    return f"{table}\n\n*[numbers]({link(file, folder)})*"


_UNSEEN_COLUMNS = (
    ("held-out dB", "heldout_psnr_db", ".2f"),
    ("right dB", "right_psnr_db", ".2f"),
    ("all left dB", "psnr_db", ".2f"),
    ("Depth-L1 cm", "depth_l1_cm", ".1f"),
)


def _unseen(kept: Path, folder: Path) -> str:
    """One line per row of the table of unseen views: each sequence's mean over the seeds, and below it how far these
    spread at most."""
    with (kept / "unseen.csv").open(newline="", encoding="utf-8") as opened:
        rows = [row for row in csv.DictReader(opened) if row["by"] == "ours"]
    cells = {(row["method"], row["metric"], row["sequence"]): row for row in rows}
    sequences = list(dict.fromkeys(row["sequence"] for row in rows if row["status"] != "average"))[:2]
    columns = [
        (f"{heading}, {sequence}", metric, sequence, form)
        for heading, metric, form in _UNSEEN_COLUMNS
        for sequence in sequences
    ]
    methods = dict.fromkeys(row["method"] for row in rows)
    lines = [
        [method, *(f"{float(cells[method, metric, at]['value']):{form}}" for _, metric, at, form in columns)]
        for method in methods
    ]
    spreads = [
        f"{max(float(cells[method, metric, sequence]['std']) for method in methods):{form}}"
        for _, metric, sequence, form in columns
    ]
    lines.append([f"*{cell}*" for cell in ("largest standard deviation above", *spreads)])
    more = f"[all notes]({link(kept / 'unseen.md', folder)}), [record]({link(kept / f'unseen{SUFFIX}', folder)})"
    table = text_table(["", *(heading for heading, _, _, _ in columns)], lines)
    return f"{table}\n\n*means over seeds {rows[0]['seeds']}; {more}*"


_MM = "`torch.mm` of 1024^3"
_WHOLE = "whole iteration (render, L1 + SSIM + geometric loss, backward, Adam)"
_ISOTROPIC = "100 k near-isotropic Gaussians, 19.6 a pixel"
_RATIOS = (
    (f"forward + backward of {_ISOTROPIC} / {_MM}", "rasterizer", "forward + backward, isotropic 100 k / mm"),
    ("the same with 12.8 a pixel", "rasterizer", "forward + backward, 12.8 a pixel, 100 k / mm"),
    (
        f"forward + backward of 100 k opaque 6:1 splats / {_MM}",
        "rasterizer",
        "forward + backward, elongated 100 k / mm",
    ),
    (f"{_WHOLE} at 100 k, 19.6 a pixel / {_MM}", "rasterizer", "whole iteration, isotropic 100 k / mm"),
    ("the same with 12.8 a pixel", "rasterizer", "whole iteration, 12.8 a pixel, 100 k / mm"),
    ("whole iteration at 1 M / at 100 k", "rasterizer", "whole iteration, 1 M / 100 k"),
    (
        "gsplat's torch projection, forward + backward / our whole forward + backward",
        "projection",
        "torch projection / our whole pass",
    ),
    ("L1 + SSIM by conv2d with autograd / fused", "ssim", "conv2d / fused"),
    ("normal term: torch with autograd / fused", "losses", "normal: torch / core"),
    ("smoothness term: torch with autograd / fused", "losses", "smooth: torch / core"),
)


def _performance(kept: Path, folder: Path) -> str:
    """The benchmarks' ratios."""
    file = kept / performance.FILE
    content = read_json(file)
    rows = []
    for label, benchmark, name in _RATIOS:
        value = performance.ratio(content, benchmark, name)
        rows.append([label, f"{value:.2f}" if value < 10 else f"{value:.0f}"])
    table = text_table(["ratio", "measured"], rows)
    return f"{table}\n\n*{performance.device_of(content)}; [numbers]({link(file, folder)})*"


# Of a paper's table, what says what its numbers are; other notes are on single runs, and on the published numbers.
_SHOWN_NOTES = (
    *(
        "Line ours",
        "Lines ours",
        "Ours: mean",
        "Mean ±",
        "Rules of",
        "†",
        "Frames that were",
        "Our numbers",
        "All our",
        "By protocol",
    ),
    *("Settings", "Made"),
)


def _of_table(name: str) -> Callable[[Path, Path], str]:
    def make(kept: Path, folder: Path) -> str:
        """A table of the paper with its main notes; the others stand beside the record."""
        table = make_table(name, [kept / f"{name}{SUFFIX}"])
        rows, _, _ = table.text("md", folder).partition("\n\n- ")
        notes = [f"- {note}" for note in table.notes if note.startswith(_SHOWN_NOTES)]
        more = link(kept / f"{name}.md", folder)
        return "\n".join([rows, "", *notes, f"- All notes: [{name}.md]({more}), also as .csv, .tex and .html."])

    return make


BLOCKS = {
    "kitti06": Block((f"kitti06{SUFFIX}",), _measured),
    "kitti06_short": Block((f"kitti06{SUFFIX}",), _measured_short),
    "performance": Block((performance.FILE,), _performance),
    "gpu": Block((), gpu_table),
    "trackers": Block((f"trackers{SUFFIX}",), _trackers),
    "features": Block((f"features{SUFFIX}",), _features),
    "circuits": Block((f"circuits{SUFFIX}",), _circuits),
    "stereo": Block(("stereo_kitti06.csv",), _stereo),
    "ablation": Block((f"ablation{SUFFIX}",), _of_table("ablation")),
    "mixed": Block((f"mixed{SUFFIX}",), _of_table("mixed")),
    "unseen": Block((f"unseen{SUFFIX}", "unseen.csv"), _unseen),
    "readings": Block((f"readings{SUFFIX}",), _of_table("readings")),
    "backbones": Block((f"backbones{SUFFIX}",), _of_table("backbones")),
    "dialects": Block((f"dialects{SUFFIX}",), _of_table("dialects")),
}
"""By the name in the marker."""
