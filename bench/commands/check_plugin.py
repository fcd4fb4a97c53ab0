"""``bgs-bench check-plugin``: does a plugin keep the contract of its kind? One line a check, with the line to mend."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from bench.authoring.candidate import candidate_of
from bench.authoring.check import findings_of
from bench.authoring.verdict import Finding

_EXAMPLES = """examples:
  bgs-bench check-plugin stereo=my_net stereo.iterations=16
  bgs-bench check-plugin stereo=my_net plugins=[my_plugins]
  bgs-bench check-plugin tracker=my_tracker dataset=kitti dataset.root=DIR dataset.sequence=06 dataset.frames=0:8
"""
_STYLES = {"ok": "green", "FAILED": "bold red", "note": "yellow"}


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "check-plugin",
        help="does a plugin keep its contract? What was expected, and the line to mend",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "overrides",
        nargs="*",
        metavar="KEY=VALUE",
        help="first KIND=NAME; then settings, plugins=[FOLDER], other parts",
    )
    parser.add_argument("--plugins", action="append", default=[], metavar="FOLDER", help="as plugins=[FOLDER]")
    parser.add_argument("--traceback", action="store_true", help="show where an exception came from")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the findings as they are made; exit code 1 when one failed. ``BenchError`` for an unknown plugin."""
    console = Console(soft_wrap=True, highlight=False)
    candidate = candidate_of(args.overrides, args.plugins)
    plugin = candidate.plugin
    console.print(Text(f"{plugin.kind}={plugin.name}  {_short(plugin.file)}", style="bold"))
    findings = []
    for finding in findings_of(candidate):
        findings.append(finding)
        _print(finding, console, args.traceback)
    failed = sum(finding.state == "FAILED" for finding in findings)
    passed = sum(finding.state == "ok" for finding in findings)
    if failed:
        console.print(Text(f"{failed} of {failed + passed} checks FAILED", style="bold red"))
        return 1
    console.print(Text(f"all {passed} checks passed", style="bold green"))
    return 0


def _print(finding: Finding, console: Console, with_traceback: bool) -> None:
    first, *details = finding.lines()
    line = Text(first)
    line.stylize(_STYLES[finding.state], 0, len(finding.state))
    console.print(line)
    for detail in details:
        console.print(Text(_short(detail)))
    if with_traceback and finding.traceback:
        console.print(Text(finding.traceback, style="dim"))


def _short(text: str) -> str:
    """Paths below the current folder without it, as an editor's terminal opens them."""
    return text.replace(f"{Path.cwd()}/", "")
