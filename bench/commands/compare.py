"""``bgs-bench compare``: two runs in the terminal, what differs in them and in their numbers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.contracts.metric import Metric
from bench.errors import BenchError
from bench.plain_text import plain_line
from bench.tables.collect import find_runs
from bench.tables.pair import FramesPair, differing_settings, frame_pairs, metric_pairs, why_not_comparable
from bench.tables.records.folder import read_run
from bench.terminal import say

_EXAMPLES = """examples:
  bgs-bench compare results/runs/a results/runs/b
  bgs-bench compare results/runs/a results/runs/b --by depth_l1_cm
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "compare",
        help="two runs: settings that differ, metrics with difference, frames in which one is better",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("a", type=Path, metavar="RUN_A")
    parser.add_argument("b", type=Path, metavar="RUN_B")
    parser.add_argument("--by", default="psnr_db", metavar="METRIC", help="compare frames by it (default: psnr_db)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print what differs; ``BenchError`` where the runs' numbers can't be compared, after their settings."""
    console = Console()
    a, b = (read_run(_run_folder(path)) for path in (args.a, args.b))
    reasons = why_not_comparable(a, b)
    for letter, record in (("A", a), ("B", b)):
        say(f"{letter}: {record.source} ({record.system}, {record.dataset}, {record.state})", console)
    settings = [(key, *("-" if each is None else each for each in values)) for key, *values in differing_settings(a, b)]
    _print(console, "settings", ("", "A", "B"), settings, "no setting differs")
    if reasons:
        raise BenchError(
            f"The numbers of {a.source} and {b.source} can't be compared: {'; '.join(reasons)}. Choose runs of "
            "the same frames; `bgs-bench evaluate RUN protocol=NAME` scores one under another protocol."
        )
    rows = [
        (f"{each.metric.title} {_unit(each.metric)}".strip(), *_numbers(each.metric, each.a, each.b), each.better)
        for each in metric_pairs(a, b)
    ]
    _print(console, "metrics", ("", "A", "B", "B - A", "better"), rows, "no metric is known of both runs")
    for pair in frame_pairs(a, b, args.by):
        _print_frames(console, pair)
    return 0


def _run_folder(path: Path) -> Path:
    found = find_runs([path])
    if found != [path]:
        raise BenchError(f"{path} is a folder of {len(found)} runs. Give two run folders.")
    return path


def _print_frames(console: Console, pair: FramesPair) -> None:
    metric = pair.metric
    counts = f"A is better in {pair.a_better}, B in {pair.b_better}, equal in {pair.equal}"
    say(f"{metric.title} of {pair.camera} views: {counts}", console)
    if pair.largest:
        rows = [(str(number), *_numbers(metric, x, y)) for number, x, y in pair.largest]
        _print(console, f"largest differences {_unit(metric)}", ("frame", "A", "B", "B - A"), rows, "")


def _unit(metric: Metric) -> str:
    return f"[{metric.unit}]" if metric.unit else ""


def _numbers(metric: Metric, a: float, b: float) -> tuple[str, str, str]:
    """Both, and the difference; digits as in tables."""
    if metric.decimals is None:
        return f"{a:,.0f}", f"{b:,.0f}", f"{b - a:+,.0f}"
    return f"{a:.{metric.decimals}f}", f"{b:.{metric.decimals}f}", f"{b - a:+.{metric.decimals}f}"


def _print(console: Console, title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], otherwise: str) -> None:
    if not rows:
        say(otherwise, console)
        return
    table = Table(title=Text(title), title_justify="left")
    for place, head in enumerate(heads):
        table.add_column(head, justify="left" if place == 0 or title == "settings" else "right", overflow="fold")
    for row in rows:
        table.add_row(*(Text(plain_line(text)) for text in row))
    console.print(table)
