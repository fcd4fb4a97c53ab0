"""``bgs-bench evaluate``: score a saved run again, without mapping again, also under another protocol."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.config import check_overrides, plugin_folders
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.rescore import copy_for
from bench.evaluation.run_evaluators import evaluate_run
from bench.evaluation.saved_run import ProgressReport, SavedRunFolder
from bench.override_text import hydra_lines
from bench.report.progress import scoring_progress
from bench.tables.collect import collect_row
from bench.tables.render import print_table
from bench.terminal import say

_EXAMPLES = """A run keeps the protocol that it was made with: under another one, or with other evaluators, its scores
go to a run folder of their own beside it, with links to the same pictures.

examples:
  bgs-bench evaluate results/runs/3f2a9c01d4e5
  bgs-bench evaluate results/runs/3f2a9c01d4e5 protocol=paper
  bgs-bench evaluate results/runs/3f2a9c01d4e5 --plugins mine        # made with a plugin in that folder
  bgs-bench evaluate results/runs/3f2a9c01d4e5 protocol.ssim=3dgs evaluator=[ate,image,dialects] --out scored
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "evaluate",
        help="score a saved run again, without mapping again, also under another protocol",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="RUN_FOLDER")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="of protocol and evaluator")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="for these scores (default: beside the run)")
    parser.add_argument(
        "--plugins",
        action="append",
        default=[],
        metavar="FOLDER",
        help="a folder of plugins that the run needs",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write ``metrics.json`` and ``per_frame.csv`` and print the run's row; ``BenchError`` for what is no run."""
    console = Console()
    chosen = [override for override in args.overrides if override.startswith("plugins=")]
    overrides = [override for override in args.overrides if override not in chosen]
    # Of the command line alone: code that the run folder names is a stranger's.
    load_plugins([*args.plugins, *plugin_folders(check_overrides(hydra_lines(chosen)))])
    with scoring_progress(console) as show:
        folder = score_again(args.folder, overrides, args.out, show)
    print_table([collect_row(folder)], console)
    if overrides:
        say(f"run folder: {folder}", console)
    return 0


def score_again(folder: Path, overrides: Sequence[str], out: Path | None, on_progress: ProgressReport) -> Path:
    """Score the run in ``folder``, with ``overrides`` of protocol and evaluators in a folder of its own; the folder
    that has these scores. Raises ``BenchError`` for what is no run, and settings that it can't be scored under."""
    if out is not None and not overrides:
        raise BenchError("--out is for scores under other settings; say which, for example protocol=paper.")
    if overrides:
        folder = copy_for(SavedRunFolder(folder), overrides, out)
    evaluate_run(folder, on_progress)
    return folder
