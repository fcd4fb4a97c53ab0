"""``bgs-bench evaluate``: score a saved run again, without mapping again."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress, TaskID

from bench.evaluation.run_evaluators import evaluate_run
from bench.tables.collect import collect_row
from bench.tables.render import print_table


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser("evaluate", help="score a saved run again, without mapping again")
    parser.add_argument("folder", type=Path, metavar="RUN_FOLDER")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write ``metrics.json`` and ``per_frame.csv`` and print the run's row; ``BenchError`` for what is no run."""
    console = Console()
    with Progress(console=console, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(f"scoring {what}")
            bar.update(tasks[what], completed=done, total=total)

        evaluate_run(args.folder, show)
    print_table([collect_row(args.folder)], console)
    return 0
