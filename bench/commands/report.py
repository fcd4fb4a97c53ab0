"""``bgs-bench report``: pages to look at runs and sweeps, which open from disk."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.report.progress import scoring_progress
from bench.runs.config_file import RUNS_FOLDER
from bench.tables.collect import find_runs
from bench.terminal import say, tell

_MOST_TOLD = 10
_EXAMPLES = """The folder needs no network and no server: open its index.html.
Maps in 3D need node and `make map-viewer`.

examples:
  bgs-bench report results/runs/3f2a9c01d4e5
  bgs-bench report results/runs/a results/runs/b --out trackers
  bgs-bench report multirun/2026-11-29 --maps 0       # a sweep: all runs in a folder
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "report",
        help="pages of runs or of a sweep: tables, trajectories, curves, pictures, maps in 3D",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("places", nargs="*", type=Path, metavar="RUN_FOLDER|SWEEP",
                        help=f"run folders, or folders of them; default: all under {RUNS_FOLDER}")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("report"), metavar="DIR", help="default: report")
    parser.add_argument("--views", type=int, metavar="N", help="pictures of N views a run (default: 8 to 24, by runs)")
    parser.add_argument("--maps", type=int, default=2, metavar="N", help="maps in 3D of the first N runs (default 2)")
    parser.add_argument("--plugins", action="append", default=[], metavar="FOLDER", help="plugins that runs need")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the report and say where it is and what it lacks; ``BenchError`` for what is no run."""
    from bench.report.pages.site import write_report  # plotly takes a while to load

    for option, value in (("--views", args.views), ("--maps", args.maps)):
        if value is not None and value < 0:
            raise BenchError(f"{option} {value} is negative; give 0 or more.")
    # Of the command line alone: code that a run folder names is a stranger's.
    load_plugins(args.plugins)
    console = Console()
    with scoring_progress(console, "reporting") as show:
        page, lacking = write_report(find_runs(args.places), args.out, args.views, args.maps, show)
    for sentence in lacking[:_MOST_TOLD]:
        tell(sentence)
    if len(lacking) > _MOST_TOLD:
        tell(f"and {len(lacking) - _MOST_TOLD} more such; the runs' pages have them")
    say(f"wrote {page}", console)
    return 0
