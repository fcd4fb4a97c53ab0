"""``bgs-bench table``: runs become rows."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.errors import BenchError
from bench.runs.atomic import write_text
from bench.tables.collect import collect_row, find_runs
from bench.tables.render import print_table, writer_for


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser("table", help="one row a run: to the terminal, and to .md, .csv, .tex")
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN_FOLDER", help="default: all under results/runs")
    parser.add_argument(
        "--out", nargs="+", action="extend", default=[], type=Path, metavar="FILE", help="FILE.md, FILE.csv or FILE.tex"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the table and write it to each ``--out``; raises ``BenchError`` for a wrong folder or extension."""
    writers = {path: writer_for(path) for path in args.out}
    rows = [collect_row(folder) for folder in find_runs(args.runs)]
    console = Console()
    print_table(rows, console)
    for path, write in writers.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BenchError(f"Can't make the folder of --out {path}: {error.strerror}. Give another place.") from error
        write_text(path, write(rows))
        console.print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)
    return 0
