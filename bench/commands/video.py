"""``bgs-bench video``: a run as mp4."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.figures.video import MPEG4, fly_through, has_h264, side_by_side, video_file
from bench.runs.folder import VIEWS
from bench.saved_map import load_map
from bench.terminal import say

_FPS = {"side-by-side": 10.0, "fly-through": 30.0}
_EXAMPLES = """examples:
  bgs-bench video results/runs/a
  bgs-bench video results/runs/a --kind fly-through --out flight.mp4
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "video",
        help="ground truth, render and depth beside each other, or a flight through the map, as mp4",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="RUN_FOLDER")
    parser.add_argument("--kind", choices=tuple(_FPS), default="side-by-side")
    parser.add_argument("--out", type=Path, metavar="FILE.mp4", help="default: the kind's name")
    parser.add_argument("--fps", type=float, metavar="N", help="pictures per second (default: 10; fly-through 30)")
    parser.add_argument("--view", choices=VIEWS, default="left", help="side-by-side: which camera")
    parser.add_argument(
        "--max-depth", type=float, default=float("nan"), metavar="M", help="side-by-side: end of the colours of depth"
    )
    parser.add_argument(
        "--smooth", type=float, default=2.0, metavar="FRAMES", help="fly-through: average the way over so many frames"
    )
    parser.add_argument(
        "--plugins", action="append", default=[], metavar="FOLDER", help="a folder of plugins that the run needs"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the video; ``BenchError`` for a run without renders, or without a map."""
    out, fps = args.out or Path(f"{args.kind}.mp4"), _FPS[args.kind] if args.fps is None else args.fps
    if out.suffix.lower() != ".mp4":
        raise BenchError(f"--out {out} must end in .mp4.")
    if not 0.1 <= fps <= 240 or args.max_depth <= 0 or not 0 <= args.smooth <= 1000:
        raise BenchError(
            "--fps goes from 0.1 to 240, --smooth from 0 to 1000 frames, and --max-depth is above 0 metres."
        )
    # Of the command line alone: code that a run folder names is a stranger's.
    load_plugins(args.plugins)
    console, saved = Console(), SavedRunFolder(args.folder)
    if args.kind == "side-by-side":
        pictures = side_by_side(saved, args.view, args.max_depth)
    else:
        pictures = fly_through(load_map(saved), args.smooth)
    with (
        Progress(console=console, transient=True, disable=not console.is_interactive) as bar,
        video_file(out, fps) as add,
    ):
        task = bar.add_task("pictures")
        for done, (picture, total) in enumerate(pictures, 1):
            add(picture)
            bar.update(task, completed=done, total=total)
    say(f"wrote {out}: {total} pictures, {'H.264' if has_h264() else MPEG4}", console)
    return 0
