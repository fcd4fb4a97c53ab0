"""``bgs-bench reproduce``: make the runs that a table of the paper wants, then write the table."""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.commands.hydra_flags import add_config_flags, add_hydra_flags, given_overrides, is_shown
from bench.config import check_overrides, plugin_folders
from bench.override_text import hydra_lines
from bench.runs.config_file import CONFIG_FILE
from bench.sweeps.launchers.choice import count_of_jobs, split_launcher
from bench.sweeps.launchers.make import make_runs
from bench.sweeps.listing import list_skipped
from bench.sweeps.lookup import look_up
from bench.sweeps.plan import Plan, make_plan
from bench.sweeps.sweep import Choice
from bench.sweeps.view import SweepView
from bench.tables.named.definitions import NamedTable
from bench.tables.named.find import named_table, table_files
from bench.tables.named.found_rows import choose_rows, with_found_rows
from bench.tables.named.overrides import row_of
from bench.tables.named.records import read_runs
from bench.tables.named.table import fill_table
from bench.tables.records.file import SUFFIX
from bench.tables.records.record import VIEW_GROUPS, RunRecord
from bench.terminal import say

_EXAMPLES = """examples:
  bgs-bench reproduce ablation dataset.root=DIR
  bgs-bench reproduce backbones dataset.root=DIR dataset.frames=0:10 mapper.iterations=8 --seeds 0 --jobs 2
  bgs-bench reproduce main_kitti dataset.root=DIR launcher=ray hydra.launcher.ray.init.address=auto
  bgs-bench reproduce main_kitti dataset.root=DIR --dry-run
  bgs-bench reproduce backbones stereo=my_net 'plugins=[FOLDER]' dataset.root=DIR    # the row of your own backbone
  bgs-bench reproduce mine 'plugins=[FOLDER]' dataset.root=DIR       # a table of yours, FOLDER/table/mine.yaml

Killed or stopped, the same command resumes where it was. A run is whole or made again; those that are there stay."""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "reproduce",
        help="make the runs that a table of the paper wants and that are not there yet, then write it",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("table", metavar="TABLE", help=f"one of {', '.join(table_files())}, or one of yours")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="for all runs, as for `bgs-bench run`")
    parser.add_argument(
        "--seeds", type=_seeds, metavar="0,1,2", help="a run of each cell for each (default: the table's, 0,1,2)"
    )
    parser.add_argument(
        "--missing", action="store_true", help="only runs without a folder; default: also those stopped or killed"
    )
    parser.add_argument("--rerun-failed", action="store_true", help="also those that failed")
    parser.add_argument("--jobs", type=count_of_jobs, metavar="N", help="so many at once (default: 1)")
    parser.add_argument("--dry-run", action="store_true", help="say what would be run, in which order, and stop")
    parser.add_argument(
        "--out", type=Path, default=Path("results/tables"), metavar="FOLDER", help="default: results/tables"
    )
    parser.add_argument("--views", choices=VIEW_GROUPS, default="left", help="whose image metrics (default: all left)")
    add_config_flags(parser)
    add_hydra_flags(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Plan, make what is missing, write the table. Exit code 0 = every run of the plan is done, 1 = not, 130 = Ctrl-C.

    Raises ``BenchError`` for wrong input, before anything is run.
    """
    overrides, launcher = split_launcher(given_overrides(args), args.jobs)
    folders = plugin_folders(check_overrides(hydra_lines(overrides)))
    table = named_table(args.table, folders)
    chosen, overrides = choose_rows(table, overrides)
    plan = make_plan(chosen, overrides, args.seeds or table.seeds)
    choice = Choice(interrupted=not args.missing, failed=args.rerun_failed)
    console = Console()
    if is_shown(plan, choice, args, console):
        return 0
    list_skipped(plan, console)
    wanted = [planned for planned in plan.runs if choice.wants(look_up(planned.folder).progress)]
    how = f"{launcher.at_once} at once" if launcher.at_once else "as many at once as the cluster gives"
    say(f"{table.name}: {len(plan.runs)} runs, {len(wanted)} to make, {how}, in {plan.root}", console)
    if launcher.at_once != 1 and any(metric.unit == "s/frame" for metric in table.metrics):
        say("note: runs that share the cores are slower; for times to publish make one at once", console)
    try:
        make_runs(plan, launcher, choice, SweepView(console, table.name, plan.runs, launcher.at_once))
    except KeyboardInterrupt:
        say(f"stopped; {_counted(plan)}. The same command resumes from there.", console)
        return 130
    _write_table(table, chosen, plan, args, console)
    say(f"{table.name}: {_counted(plan)}", console)
    return 0 if all(look_up(planned.folder).progress == "finished" for planned in plan.runs) else 1


def _seeds(text: str) -> tuple[int, ...]:
    try:
        seeds = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no list of whole numbers such as 0,1,2") from None
    if min(seeds) < 0 or len(set(seeds)) < len(seeds):
        raise argparse.ArgumentTypeError(f"{text!r} must hold different numbers, 0 or more")
    return seeds


def _write_table(table: NamedTable, chosen: NamedTable, plan: Plan, args: argparse.Namespace, console: Console) -> None:
    """Print the table of this plan's runs alone, where some rows were ``chosen`` with what is there of the others, and
    write it in every format; without any run there is none."""
    folders = [planned.folder for planned in plan.runs if (planned.folder / CONFIG_FILE).is_file()]
    if not folders:
        say("no run was made, so the table was not written", console)
        return
    kept = read_runs(folders, args.views)
    if chosen is not table:
        kept = replace(kept, runs=(*kept.runs, *_of_other_rows(table, chosen, plan, args)))
    filled = fill_table(table, kept)
    filled.print(console)
    for file in filled.write(args.out):
        say(f"wrote {file}", console)


def _of_other_rows(table: NamedTable, chosen: NamedTable, plan: Plan, args: argparse.Namespace) -> list[RunRecord]:
    """Runs of the table's rows that were not chosen: those in the folder of the runs, and in the table's record."""
    record = args.out / f"{table.name}{SUFFIX}"
    places = [place for place in (record, plan.root) if place.exists()]
    found = {run.name: run for place in places for run in read_runs([place], args.views).runs}
    table = with_found_rows(table, [run.config for run in found.values()])
    return [
        run for run in found.values() if row_of(table, run.config) is not None and row_of(chosen, run.config) is None
    ]


def _counted(plan: Plan) -> str:
    """How many runs are in which state, for example "19 finished, 2 failed"."""
    counts = Counter(look_up(planned.folder).progress for planned in plan.runs)
    return ", ".join(f"{count} {progress}" for progress, count in counts.most_common())
