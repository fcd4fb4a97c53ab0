"""``bgs-bench table``: runs become rows, or the cells of one of the paper's tables."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.errors import BenchError, did_you_mean, require_choice
from bench.runs.config_file import RUNS_FOLDER
from bench.tables.document.forms import FORMS, form_of, save
from bench.tables.document.model import Document
from bench.tables.frame import expanded, rows_at
from bench.tables.named.find import table_names
from bench.tables.named.grid import COLUMNS
from bench.tables.named.records import read_runs
from bench.tables.named.table import make_table
from bench.tables.records.file import SUFFIX, is_record_file, record_text
from bench.tables.records.record import VIEW_GROUPS
from bench.tables.render import print_table, runs_document
from bench.terminal import say

_ABOUT = f"""The named tables are NAMES; without a name: one row per run.
A table of yours is FOLDER/table/NAME.yaml, with its published numbers beside it as CSV; give --plugins FOLDER.

A record file (NAME{SUFFIX}) keeps what tables need of runs when the run folders are gone. It goes wherever run folders
go, and gives the same tables; --out FOLDER writes one beside a named table, whose cells link to it."""

_EXAMPLES = f"""examples:
  bgs-bench table main_kitti results/runs --out results/tables
  bgs-bench table main_kitti results/tables/main_kitti{SUFFIX} --format tex
  bgs-bench table mine results/runs --plugins FOLDER
  bgs-bench table results/runs/a results/runs/b --out trackers.md trackers{SUFFIX}"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "table",
        help="one row per run, or one of the paper's tables: to the terminal, and to .md, .csv, .tex, .html",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
    )
    parser.add_argument("-h", "--help", action=_Help, nargs=0, help="show this help and exit; --plugins goes before it")
    parser.add_argument(
        "places",
        nargs="*",
        metavar="[NAME] RUN_FOLDER",
        help=f"name of a table, then run folders, folders of them or record files; default: all under {RUNS_FOLDER}",
    )
    parser.add_argument(
        "--out",
        nargs="+",
        action="extend",
        default=[],
        type=Path,
        metavar="PLACE",
        help=f"FILE.md, .csv, .tex, .html or {SUFFIX}; for a named table also a folder, for all of them",
    )
    parser.add_argument(
        "--format", choices=FORMS, help="print this instead; with a named table and --out FOLDER, write only this"
    )
    parser.add_argument(
        "--views", choices=VIEW_GROUPS, help="named table: whose image metrics (default: a record's own, else left)"
    )
    parser.add_argument(
        "--columns", choices=COLUMNS, default="both", help="named table: our numbers, the paper's, or both (default)"
    )
    parser.add_argument(
        "--plugins", action="append", default=[], metavar="FOLDER", help="a folder with tables of yours"
    )
    parser.set_defaults(run=run)


class _Help(argparse.Action):
    """Help that lists the tables in the user's folders too."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *_: Any) -> None:
        """Print it and exit."""
        parser.description = _ABOUT.replace("NAMES", ", ".join(table_names(namespace.plugins)))
        parser.print_help()
        parser.exit()


def run(args: argparse.Namespace) -> int:
    """Print the table and write it to each ``--out``; raises ``BenchError`` for a wrong name, folder or extension."""
    paths = [Path(place) for place in args.places]
    name = args.places[0] if paths else ""
    names = table_names(args.plugins)
    if name in names:
        return _named(name, paths[1:], args)
    if name and "/" not in name and not paths[0].exists():
        raise BenchError(
            f"There is no folder and no table {name}; the tables are {', '.join(names)}, and those in --plugins FOLDER."
            f"{did_you_mean(name, names)}"
        )
    if args.columns != "both":
        raise BenchError(f"--columns {args.columns} is for a named table, one of {', '.join(names)}.")
    forms = {path: "" if is_record_file(path) else form_of(path, f" or {SUFFIX}") for path in args.out}
    rows = rows_at(paths)
    document = runs_document(rows)
    if args.format and not args.out:
        print(document.text(args.format), end="")
        return 0
    console = Console()
    print_table(rows, console)
    for path, form in forms.items():
        text = document.text(form, path.parent) if form else record_text(read_runs(paths))
        _write(path, text, console)
    return 0


def table_document(
    *places: str | Path,
    name: str | None = None,
    views: str | None = None,
    columns: str = "both",
    plugins: Sequence[str] = (),
) -> Document:
    """The table that ``bgs-bench table`` makes of the runs in ``places``: ``text("tex")`` writes it, ``frame()`` has
    its numbers, ``notes`` what stands below it.

    ``places`` as for ``bench.load_runs``. ``name``: one of the paper's tables ("main_kitti"), or one in a folder of
    ``plugins``; None: a row per run. Of a named table, ``views`` says whose image metrics ("left", "heldout", "right";
    None: a record file's own, else left), ``columns`` whose numbers ("ours", "paper" or "both"). Raises ``BenchError``
    for another name or value, and for a place that holds no run.
    """
    paths = [path for place in places for path in expanded(str(place))]
    if name is not None:
        return make_table(name, paths, views, plugins, require_choice("columns", columns, COLUMNS)).document
    if views is not None or columns != "both":
        raise BenchError("views and columns are for a named table; say its name too, or leave them out.")
    return runs_document(rows_at(paths))


def _named(name: str, runs: list[Path], args: argparse.Namespace) -> int:
    files = [place for place in args.out if _is_file(place)]
    table = make_table(name, runs, args.views, args.plugins, args.columns)
    if args.format and not args.out:
        print(table.text(args.format, Path()), end="")
        return 0
    console = Console()
    table.print(console)
    for file in files:
        text = record_text(table.runs) if is_record_file(file) else table.text(file.suffix[1:], file.parent)
        _write(file, text, console)
    for folder in args.out:
        if folder not in files:
            for file in table.write(folder, [args.format] if args.format else FORMS):
                _say_wrote(file, console)
    return 0


def _is_file(place: Path) -> bool:
    """Whether an ``--out`` names a file of a form that there is; otherwise it is a folder."""
    if not place.suffix or place.is_dir():
        return False
    return is_record_file(place) or bool(form_of(place, f", {SUFFIX}, or name a folder"))


def _write(path: Path, text: str, console: Console) -> None:
    save(path, text)
    _say_wrote(path, console)


def _say_wrote(path: Path, console: Console) -> None:
    say(f"wrote {path}", console)
