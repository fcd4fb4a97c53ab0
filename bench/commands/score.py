"""``bgs-bench score``: the errors of any trajectory file in KITTI's or TUM's format."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.errors import BenchError
from bench.evaluation.score import score_pair
from bench.evaluation.trajectory import ALIGNMENTS
from bench.evaluation.trajectory_pair import FORMATS, read_pair
from bench.tables.collect import Column, Row, about_lost_frames, static_camera_of
from bench.tables.render import print_table

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
_EXAMPLES = """examples:
  bgs-bench score --trajectory orbslam2_06.txt --ground-truth kitti_odometry/poses/06.txt
  bgs-bench score --trajectory CameraTrajectory.txt --ground-truth poses/06.txt --times sequences/06/times.txt --json
  bgs-bench score --trajectory first_51.txt --ground-truth poses/06.txt --frames 0:51 --plot first_51.png
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "score",
        help="ATE, RPE, t_rel and r_rel of any trajectory file (KITTI or TUM)",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--trajectory", required=True, type=Path, metavar="FILE", help="the estimate")
    parser.add_argument("--ground-truth", required=True, type=Path, metavar="FILE")
    parser.add_argument("--format", choices=FORMATS, default="auto", help="of both files; auto: by values a line")
    parser.add_argument(
        "--alignment", choices=ALIGNMENTS, default="se3", help="default: se3 (no scale); sim3 is for single cameras"
    )
    parser.add_argument("--frames", default="", metavar="FIRST:END", help="KITTI: the ground truth's lines to use")
    parser.add_argument("--times", type=Path, metavar="FILE", help="times of the KITTI file beside a TUM file")
    parser.add_argument(
        "--max-time-difference", type=float, default=0.01, metavar="S", help="TUM: of poses that belong together"
    )
    parser.add_argument("--json", action="store_true", help="print JSON in the form of metrics.json")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the trajectory and its errors")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Score, print and plot; ``BenchError`` for files that can't be read or don't belong together."""
    if args.plot is not None and args.plot.suffix != ".png":
        raise BenchError(f"--plot {args.plot}: the picture is a PNG; give a name that ends in .png.")
    pair = read_pair(args.trajectory, args.ground_truth, args.format, args.times, args.max_time_difference, args.frames)
    score = score_pair(pair, args.alignment)
    if args.plot is not None:
        from bench.report.trajectory_plot import write_trajectory_plot  # matplotlib takes a while to load

        write_trajectory_plot(args.plot, score.ate, pair.ground_truth, score.rpe)
    if args.json:
        print(json.dumps(score.metrics, indent=2, allow_nan=False))
        return 0
    console = Console()
    print_table([_row(args.trajectory.name, args.ground_truth.name, score.metrics)], console, COLUMNS)
    if args.plot is not None:
        console.print(f"wrote {args.plot}", markup=False, highlight=False, soft_wrap=True)
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
