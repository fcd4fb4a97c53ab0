"""``bgs-bench map``: what a saved map holds, and a frame of its run rendered from it again."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.gaussians.map import GaussianMap
from bench.gaussians.parameters import NamedParameters
from bench.io.atomic import write_image
from bench.runs.folder import color_to_8bit
from bench.saved_map import load_map, map_file
from bench.terminal import say

_EXAMPLES = """examples:
  bgs-bench map results/runs/3f2a9c01d4e5
  bgs-bench map point_cloud.ply
  bgs-bench map results/runs/3f2a9c01d4e5 --view 5 --right --out view.png
"""
_QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "map",
        help="what a saved map of Gaussians holds; renders a frame of its run",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", type=Path, metavar="RUN_FOLDER|FILE.ply")
    parser.add_argument(
        "--view",
        type=int,
        metavar="FRAME",
        help="render this frame of the run, from its tracked pose, without its exposure",
    )
    parser.add_argument("--right", action="store_true", help="the right camera's view of it")
    parser.add_argument("--out", type=Path, metavar="FILE.png", help="where the rendered view goes")
    parser.add_argument(
        "--plugins",
        action="append",
        default=[],
        metavar="FOLDER",
        help="a folder of plugins that the run needs",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the map's numbers, or write a view; ``BenchError`` for what is no map, or no frame of the run."""
    if (args.view is None) != (args.out is None) or (args.right and args.view is None):
        raise BenchError("A view wants both --view FRAME and --out FILE.png (and --right for the right camera).")
    if args.view is not None and args.out.suffix.lower() != ".png":
        raise BenchError(f"--out {args.out} must end in .png.")
    if args.view is not None and not args.source.is_dir():
        raise BenchError(f"--view renders a frame of a run; give its run folder instead of {args.source}.")
    # Of the command line alone: code that the run folder names is a stranger's.
    load_plugins(args.plugins)
    if args.view is None:
        path = map_file(SavedRunFolder(args.source)) if args.source.is_dir() else args.source
        _print(path, GaussianMap.load(path), Console())
    else:
        saved = load_map(args.source)
        write_image(args.out, color_to_8bit(saved.render(saved.view_of(args.view, args.right)).color))
        print(args.out)
    return 0


def _print(path: Path, gaussians: GaussianMap, console: Console) -> None:
    facts = f"{path}: {len(gaussians)} Gaussians, spherical harmonics of degree {gaussians.sh_degree}"
    say(f"{facts}, {path.stat().st_size / 1e6:.1f} MB", console)
    if not len(gaussians):
        return
    table = Table(box=None)
    table.add_column("quantile", no_wrap=True)
    for share in _QUANTILES:
        table.add_column(f"{100 * share:g} %", justify="right")
    named = NamedParameters(gaussians.planes)
    rows = {f"{axis}, m": named.means[:, k] for k, axis in enumerate("xyz")}
    rows |= {"opacity": named.opacities}
    rows |= {"longest axis, m": named.scales.amax(1), "shortest axis, m": named.scales.amin(1)}
    for name, values in rows.items():
        ordered = values.sort().values
        places = [round(share * (len(ordered) - 1)) for share in _QUANTILES]
        table.add_row(name, *(f"{float(ordered[place]):.4g}" for place in places))
    console.print(table)
