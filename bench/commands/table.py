"""``bgs-bench table``: runs become rows, or the cells of one of the paper's tables."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.errors import BenchError, did_you_mean
from bench.runs.atomic import write_text
from bench.tables.collect import collect_row, find_runs
from bench.tables.named.definitions import TABLE_NAMES
from bench.tables.named.records import VIEW_GROUPS
from bench.tables.named.table import FORMATS, make_table
from bench.tables.render import print_table, writer_for


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "table",
        help="one row a run, or one of the paper's tables: to the terminal, and to .md, .csv, .tex, .html",
        description=f"The paper's tables are {', '.join(TABLE_NAMES)}; without a name: one row a run.",
    )
    parser.add_argument(
        "runs",
        nargs="*",
        type=Path,
        metavar="[NAME] RUN_FOLDER",
        help="name of a table, then run folders or folders of them; default: all under results/runs",
    )
    parser.add_argument(
        "--out",
        nargs="+",
        action="extend",
        default=[],
        type=Path,
        metavar="PLACE",
        help="FILE.md, FILE.csv, FILE.tex; for a named table also FILE.html, or a folder for all of them",
    )
    parser.add_argument(
        "--format", choices=FORMATS, help="named table: print this instead, or write only this to --out FOLDER"
    )
    parser.add_argument(
        "--views", choices=VIEW_GROUPS, default="left", help="named table: whose image metrics (default: all left)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the table and write it to each ``--out``; raises ``BenchError`` for a wrong name, folder or extension."""
    name = str(args.runs[0]) if args.runs else ""
    if name in TABLE_NAMES:
        return _named(name, args.runs[1:], args)
    if near := "" if not name or args.runs[0].exists() else did_you_mean(name, TABLE_NAMES):
        raise BenchError(f"There is no folder and no table {name}; the tables are {', '.join(TABLE_NAMES)}.{near}")
    if args.format:
        raise BenchError("--format goes with a table's name; write the table of runs with --out FILE.md or FILE.csv.")
    writers = {path: writer_for(path) for path in args.out}
    rows = [collect_row(folder) for folder in find_runs(args.runs)]
    console = Console()
    print_table(rows, console)
    for path, write in writers.items():
        _write(path, write(rows), console)
    return 0


def _named(name: str, runs: list[Path], args: argparse.Namespace) -> int:
    files = [file for place in args.out for file in _files_of(place, name, args.format)]
    table = make_table(name, runs, args.views)
    if args.format and not files:
        print(table.text(args.format, Path()), end="")
        return 0
    console = Console()
    table.print(console)
    for file in files:
        _write(file, table.text(file.suffix[1:], file.parent), console)
    return 0


def _files_of(place: Path, name: str, form: str | None) -> list[Path]:
    """The files that an ``--out`` stands for: itself, or in a folder one of each format."""
    if place.suffix and not place.is_dir():
        if place.suffix[1:] not in FORMATS:
            raise BenchError(f"--out {place}: the extension must be one of .{', .'.join(FORMATS)}, or name a folder.")
        return [place]
    return [place / f"{name}.{each}" for each in ([form] if form else FORMATS)]


def _write(path: Path, text: str, console: Console) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(f"Can't make the folder of --out {path}: {error.strerror}. Give another place.") from error
    write_text(path, text)
    console.print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)
