"""``bgs-bench figure``: the paper's figures, from run folders."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.figures.chosen import VIEWS, methods_of, shown_of
from bench.figures.grid import files_of, write_grid
from bench.figures.paper import WHATS, comparison, teaser
from bench.terminal import say

_EXAMPLES = """comparison: methods in rows, frames in columns, colour and depth, the ground truth last.
teaser: methods in columns, the render of one frame above its depth.
Depth has one colour map and range for all.

examples:
  bgs-bench figure comparison SplaTAM=runs/splatam BGS-SLAM=runs/bgs_slam --frames 2 7
  bgs-bench figure comparison runs/a runs/b --views heldout right --out figures/unseen.pdf
  bgs-bench figure teaser runs/splatam runs/lidar runs/bgs_slam --frames 5
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "figure",
        help="the paper's figures from run folders, as PNG and PDF",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("kind", choices=("teaser", "comparison"))
    parser.add_argument("runs", nargs="+", metavar="RUN_FOLDER|NAME=RUN_FOLDER")
    parser.add_argument(
        "--frames", nargs="+", type=int, default=[], metavar="N", help="frame numbers (default: comparison 2, teaser 1)"
    )
    parser.add_argument(
        "--views", nargs="+", choices=VIEWS, default=["left"], help="heldout: left views that mapping never saw"
    )
    parser.add_argument("--what", nargs="+", choices=WHATS, default=list(WHATS), help="comparison: columns of a view")
    parser.add_argument(
        "--max-depth", type=float, default=float("nan"), metavar="M", help="end of the colours of depth"
    )
    parser.add_argument("--width", type=float, default=7.0, metavar="INCHES", help="width in print (default: 7)")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="FILE.png, FILE.pdf, or FILE for both (default: the kind's name)"
    )
    parser.add_argument(
        "--plugins", action="append", default=[], metavar="FOLDER", help="a folder of plugins that the runs need"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the figure; ``BenchError`` for runs that do not show the same."""
    if args.max_depth <= 0 or not 1 <= args.width <= 50:
        raise BenchError("--max-depth must be above 0 metres, and --width lie between 1 and 50 inches.")
    is_teaser = args.kind == "teaser"
    if is_teaser and (len(args.frames) > 1 or len(args.views) > 1):
        raise BenchError("A teaser shows one view of one frame; give one each of --frames and --views.")
    files = files_of(args.out or Path(args.kind))
    # Of the command line alone: code that a run folder names is a stranger's.
    load_plugins(args.plugins)
    console = Console()
    methods = methods_of(args.runs)
    shown, common = shown_of(methods, args.views, args.frames, 1 if is_teaser else 2)
    if not args.frames:
        say(f"{common} Shown: {', '.join(f'{each.number} {each.camera}' for each in shown)}.", console)
    kinds = {method.name: method.run.protocol.rendered_depth for method in methods}
    if len(set(kinds.values())) > 1:
        say(f"note: the depth is not the same thing in all: {', '.join(f'{n} {k}' for n, k in kinds.items())}", console)
    if is_teaser:
        grid = teaser(methods, shown[0], args.max_depth)
    else:
        grid = comparison(methods, shown, list(dict.fromkeys(args.what)), args.max_depth)
    for file in files:
        write_grid(file, grid, args.width)
        say(f"wrote {file}", console)
    return 0
