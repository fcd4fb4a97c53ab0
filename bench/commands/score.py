"""``bgs-bench score``: any system's output by the bench's evaluators, or the errors of one trajectory file."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.commands.evaluate import score_again
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.score import score_pair
from bench.evaluation.trajectory import ALIGNMENTS
from bench.evaluation.trajectory_pair import FORMATS, read_pair
from bench.external.score import score_folder
from bench.external.settings import AXES, CONVENTIONS, NUMBERS, STATES
from bench.hydra_settings import typed_overrides
from bench.override_text import quoted
from bench.report.progress import scoring_progress
from bench.runs.config_file import read_config
from bench.tables.collect import Column, Row, about_lost_frames, collect_row, static_camera_of
from bench.tables.render import print_table
from bench.terminal import say

COLUMNS = (
    Column("run", "Trajectory"),
    Column("dataset", "Ground truth"),
    Column("frames", "Frames"),
    Column("ate_rmse_m", "ATE", "m", 3),
    Column("rpe_trans_rmse_m", "RPE", "m", 4),
    Column("rpe_rot_mean_deg", "RPE, rotation, mean", "deg", 4),
    Column("t_rel_percent", "t_rel", "%", 3, optional=True),
    Column("r_rel_deg_per_100m", "r_rel", "deg/100m", 3, optional=True),
    Column("t_rel_short_percent", "t_rel 10-50 m", "%", 3, optional=True),
    Column("r_rel_short_deg_per_100m", "r_rel 10-50 m", "deg/100m", 3, optional=True),
)
_DESCRIPTION = """Scores a folder of another system's output (trajectory, renders, depth, or any of them) on a data set,
as a run folder that `bgs-bench table` and `bgs-bench evaluate` take like any other. What the folder holds is found by
names, or said by options or a score.yaml in it. With --trajectory and --ground-truth and no folder: two files."""
_EXAMPLES = """examples:
  bgs-bench score out/monogs_03 --name MonoGS dataset=kitti dataset.root=DIR dataset.sequence=03 protocol=paper
  bgs-bench score out/mine --name Mine dataset=kitti dataset.root=DIR --trajectory poses.npy --renders 'img/left_*.png'
  bgs-bench score --trajectory orbslam2_06.txt --ground-truth kitti_odometry/poses/06.txt
  bgs-bench score --trajectory CameraTrajectory.txt --ground-truth poses/06.txt --times sequences/06/times.txt --json
  bgs-bench score --trajectory first_51.txt --ground-truth poses/06.txt --frames 0:51 --plot first_51.png
"""
_PAIR_ONLY = ("format", "alignment", "frames", "times", "plot")
_FOLDER_ONLY = (
    *("name", "renders", "renders_right", "depth", "depth_scale", "numbers", "convention", "axes", "held_out"),
    *("status", "reason"),
)
"""Options of a folder: each is the setting of ``ScoreSettings`` with its name."""
_OVERRIDE = re.compile(r"[+~]*[\w.@/]+=")


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "score",
        help="another system's output by our evaluators; or ATE, RPE, t_rel and r_rel of a trajectory file",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "overrides", nargs="*", metavar="FOLDER KEY=VALUE", help="the output, and data set, protocol and evaluators"
    )
    parser.add_argument("--trajectory", metavar="FILE", help="the estimate; with a folder: a file in it, or none")
    parser.add_argument("--json", action="store_true", help="print JSON in the form of metrics.json")
    parser.add_argument(
        "--max-time-difference", type=float, metavar="S", help="TUM: of poses that belong together (default: 0.01 s)"
    )
    _add_folder_options(parser.add_argument_group("with a folder"))
    _add_pair_options(parser.add_argument_group("with two files"))
    parser.set_defaults(run=run)


def _add_folder_options(group: Any) -> None:
    group.add_argument("--name", metavar="SYSTEM", help="how tables call the system")
    group.add_argument("--dataset", metavar="NAME", help="the same as dataset=NAME")
    group.add_argument("--output", type=Path, metavar="RUN_FOLDER", help="default: results/runs/<hash>")
    group.add_argument("--seed", type=int, help="of the system's run: tables average over seeds (default: 0)")
    group.add_argument("--renders", metavar="SUBFOLDER", help="left images; the last part may be a pattern, or none")
    group.add_argument("--renders-right", metavar="SUBFOLDER", help="right images")
    group.add_argument("--depth", metavar="SUBFOLDER", help="depth of left images: 16-bit PNG, or .npy in metres")
    group.add_argument("--depth-scale", type=float, metavar="N", help="stored / N = metres (PNG: 256, .npy: 1)")
    group.add_argument("--numbers", choices=NUMBERS, help="what numbers in names and lines count (default: what fits)")
    group.add_argument("--convention", choices=CONVENTIONS, help="of the poses (default: the format's)")
    group.add_argument("--axes", choices=AXES, help="of the camera in the poses (default: the format's)")
    group.add_argument("--held-out", action="store_true", default=None, help="the map never saw held-out frames")
    group.add_argument("--status", choices=STATES, help="how the system's run ended (default: done)")
    group.add_argument("--reason", metavar="TEXT", help="why it ended so")


def _add_pair_options(group: Any) -> None:
    group.add_argument("--ground-truth", type=Path, metavar="FILE")
    group.add_argument("--format", choices=FORMATS, help="of both files (default: by values per line)")
    group.add_argument("--alignment", choices=ALIGNMENTS, help="default: se3 (no scale); sim3 is for single cameras")
    group.add_argument("--frames", metavar="FIRST:END", help="KITTI: the ground truth's lines to use")
    group.add_argument("--times", type=Path, metavar="FILE", help="times of the KITTI file beside a TUM file")
    group.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the trajectory and its errors")


def run(args: argparse.Namespace) -> int:
    """Score, print and plot; ``BenchError`` for files that can't be read or don't belong together."""
    folders = [item for item in args.overrides if not _OVERRIDE.match(item)]
    if args.ground_truth is not None:
        _require_unused(args, (*_FOLDER_ONLY, "dataset", "output", "seed"), "goes with a folder, not with two files")
        if args.overrides:
            raise BenchError(f"{args.overrides[0]}: two files are scored without it; leave it, or --ground-truth, out.")
        return _score_pair(args)
    if len(folders) != 1:
        given = "and none is given" if not folders else f"and {len(folders)} are given ({', '.join(folders[:3])})"
        raise BenchError(
            f"One folder with a system's output is needed, {given}; or --trajectory FILE and --ground-truth FILE."
        )
    _require_unused(args, _PAIR_ONLY, "goes with two files (--trajectory, --ground-truth), not with a folder")
    return _score_folder(Path(folders[0]), [item for item in args.overrides if item not in folders], args)


def score_saved(
    folder: str | Path,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    *,
    output: str | Path | None = None,
    plugins: Sequence[str] = (),
    progress: bool = False,
    **settings: Any,
) -> Path:
    """Score a finished run again, as ``bgs-bench evaluate`` does, or another system's output, as ``bgs-bench score``
    does; the run folder that has the scores (``metrics.json``; ``bench.load_runs`` reads it).

    ``folder``: a run folder, whose scores are made again, under other ``overrides`` of protocol and evaluators in a
    folder beside it; or another system's output, with ``overrides`` for data set, protocol and evaluators, and
    ``settings`` that say how to read it: ``name="MonoGS"`` and all others of ``ScoreSettings``, which go over
    ``score.yaml`` in the folder. ``overrides`` as for ``bench.run``. ``output``: where the scores go. ``plugins``:
    folders with plugins that are needed; those that a run folder names are not looked into. ``progress`` shows the bar,
    and what was found. Raises ``BenchError`` for wrong input, before anything is written.
    """
    folder, given, console = Path(folder), typed_overrides(overrides), Console(quiet=not progress)
    if not folder.is_dir():
        raise BenchError(f"There is no folder {folder} to score. Check the path.")
    load_plugins(plugins)
    with scoring_progress(console) as show:
        if read_config(folder) is not None:
            if settings:
                raise BenchError(
                    f"{next(iter(settings))} is for another system's output, and {folder} is a run folder."
                )
            return score_again(folder, given, None if output is None else Path(output), show)
        if output is not None:
            given.append(f"output={quoted(output)}")
        return score_folder(folder, given, settings, lambda line: say(line, console), show).path


def _require_unused(args: argparse.Namespace, names: Sequence[str], why: str) -> None:
    for name in names:
        if getattr(args, name) is not None:
            raise BenchError(f"--{name.replace('_', '-')} {why}. Leave it out.")


def _score_folder(folder: Path, overrides: list[str], args: argparse.Namespace) -> int:
    overrides = [f"dataset={args.dataset}"] * (args.dataset is not None) + overrides
    overrides += [f"seed={args.seed}"] * (args.seed is not None)
    if args.output is not None:
        overrides.append(f"output={quoted(args.output)}")
    options = {name: getattr(args, name) for name in _FOLDER_ONLY}
    options |= {"trajectory": args.trajectory, "max_time_difference_s": args.max_time_difference}
    console = Console(stderr=args.json)

    def tell(line: str) -> None:
        say(line, console)

    with scoring_progress(console) as show:
        scored = score_folder(folder, overrides, options, tell, show)
    if args.json:
        print(json.dumps(scored.metrics, indent=2, allow_nan=False))
        return 0
    print_table([collect_row(scored.path)], console)
    tell(f"run folder: {scored.path}" + (" (it held this output already)" if scored.was_there else ""))
    return 0


def _score_pair(args: argparse.Namespace) -> int:
    if args.trajectory is None:
        raise BenchError("--ground-truth needs --trajectory FILE beside it, the estimate.")
    if args.plot is not None and args.plot.suffix != ".png":
        raise BenchError(f"--plot {args.plot}: the picture is a PNG; give a name that ends in .png.")
    estimate = Path(args.trajectory)
    tolerance_s = 0.01 if args.max_time_difference is None else args.max_time_difference
    pair = read_pair(estimate, args.ground_truth, args.format or "auto", args.times, tolerance_s, args.frames or "")
    score = score_pair(pair, args.alignment or "se3")
    if args.plot is not None:
        from bench.report.trajectory_plot import write_trajectory_plot  # matplotlib takes a while to load

        write_trajectory_plot(args.plot, score.ate, pair.ground_truth, score.rpe)
    if args.json:
        print(json.dumps(score.metrics, indent=2, allow_nan=False))
        return 0
    console = Console()
    print_table([_row(estimate.name, args.ground_truth.name, score.metrics)], console, COLUMNS)
    if args.plot is not None:
        say(f"wrote {args.plot}", console)
    return 0


def _row(name: str, truth_name: str, metrics: dict[str, Any]) -> Row:
    trajectory, frames = metrics["trajectory"], metrics["frames"]
    values = trajectory | {"run": name, "dataset": truth_name, "frames": f"{frames['tracked']}/{frames['total']}"}
    notes = about_lost_frames(frames, trajectory)
    if "segments_m" in trajectory:
        counts = zip(trajectory["segment_pairs"], trajectory["segments_m"], strict=True)
        shown = ", ".join(f"{count} of {length:.0f} m" for count, length in counts)
        lost = trajectory["segment_pairs_lost"]
        notes.append(f"segments: {shown}" + (f"; {lost} lost" if lost else ""))
    notes += metrics["notes"].values()
    return Row(values, metrics["protocol"], tuple(notes), static_camera_of(trajectory, frames))
