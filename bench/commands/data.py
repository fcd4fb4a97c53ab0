"""``bgs-bench data``: which data sets there are, fetching them, checking folders, making sequences."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, MofNCompleteColumn, Progress, TextColumn, TransferSpeedColumn

from bench import registry
from bench.config import compose_run
from bench.data.check import CheckOptions, Verdict, check_folder, verdict_on
from bench.data.fetch import FetchOptions, address, fetch, is_here, read_record, read_sums
from bench.data.kitti_layout import write_kitti
from bench.data.manifest import Archive, DataSet, entry, manifest
from bench.data.places import data_root
from bench.discovery import load_plugins
from bench.errors import BenchError, require_choice
from bench.terminal import say

_EXAMPLES = """examples:
  bgs-bench data list
  bgs-bench data get kitti --sequence 06 --part color velodyne
  bgs-bench data check DIR
  bgs-bench data make street dataset.frames=40
"""
_MADE = {"street": "street_kitti"}
"""What ``make`` makes: a data set of the project, and the folder below $BGS_DATA that holds it in KITTI's layout."""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "data",
        help="data sets: what there is, get it, check a folder, make a sequence",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    listing = actions.add_parser("list", help="every data set: here or not, size, licence, page, parts, sequences")
    listing.set_defaults(run=_list)
    getting = actions.add_parser("get", help="download into $BGS_DATA and unpack; resumes where a download was cut")
    getting.add_argument("name", metavar="NAME")
    getting.add_argument("--sequence", nargs="+", default=[], metavar="S", help="only these sequences")
    getting.add_argument("--part", nargs="+", default=[], metavar="P", help="these parts, of those that `list` names")
    getting.add_argument("--mirror", default=os.environ.get("BGS_DATA_MIRROR", ""), metavar="URL", help=_MIRROR)
    getting.add_argument("--sums", type=Path, metavar="FILE", help="SHA-256 that you know, as sha256sum writes them")
    getting.add_argument("--keep", action="store_true", help="keep the archives after they are unpacked")
    getting.set_defaults(run=_get)
    checking = actions.add_parser("check", help="read a folder as its loader does: what is missing, cut, of wrong kind")
    checking.add_argument("what", nargs="*", metavar="DIR | KEY=VALUE", help="a root, or dataset=NAME and its settings")
    checking.add_argument("--dataset", default="", metavar="NAME", help="the loader; without: each whose layout it has")
    checking.add_argument("--all", action="store_true", help="decode every frame, not three of each sequence")
    checking.add_argument("--pictures", type=Path, metavar="DIR", help="write a pair of each sequence, rows matched")
    checking.set_defaults(run=_check)
    making = actions.add_parser("make", help="write a sequence that the project renders, as files in KITTI's layout")
    making.add_argument("name", choices=sorted(_MADE))
    making.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="settings, such as dataset.frames=40")
    making.add_argument("--out", type=Path, metavar="DIR", help="instead of a folder in $BGS_DATA")
    making.set_defaults(run=_make)


_MIRROR = "the folder of the archives on a server of yours, in place of the publisher's ($BGS_DATA_MIRROR)"


def _list(args: argparse.Namespace) -> int:
    root = data_root()
    print(f"folder: {root}{'' if os.environ.get('BGS_DATA') else '  (set $BGS_DATA for another)'}")
    record = read_record(root)
    for data in manifest():
        there = "" if not (root / data.folder).is_dir() else f"; here: {root / data.folder}"
        print(f"{data.name}: {data.about}; licence: {data.licence}{there}")
        if data.by_hand:
            print(f"    by hand, from {data.page} below {root / data.folder}: {'; '.join(data.by_hand)}")
            continue
        print(f"    `bgs-bench data get {data.name}`; page: {data.page}")
        for archive in data.archives:
            if known := record.get(f"{data.name}/{archive.file}"):
                of_it = "" if known.of_all else f", of it {', '.join(known.unpacked)}"
                print(f"    fetched: {archive.file}{of_it}")
        parts = list(dict.fromkeys(archive.part for archive in data.archives if archive.part))
        if parts:
            print(f"    parts: {', '.join(parts)}; without --part: {', '.join(data.parts)}")
        if data.sequences:
            print(f"    sequences: {', '.join(data.sequences)}")
        sizes = [f"{archive.file} {archive.about_gb:g} GB" for archive in data.archives if archive.about_gb]
        if sizes:
            print(f"    about {', '.join(sizes)}")
    return 0


def _get(args: argparse.Namespace) -> int:
    data, root = entry(args.name), data_root()
    if data.by_hand:
        raise BenchError(
            f"{data.name} can't be fetched by a program. From {data.page} fetch {'; '.join(data.by_hand)}, below "
            f"{root / data.folder}. Then: bgs-bench data check {root / data.folder}"
        )
    options = FetchOptions(args.mirror, {} if args.sums is None else read_sums(args.sums), args.keep)
    chosen = data.chosen(args.part, args.sequence)
    print(f"{data.name}: licence {data.licence}; see {data.page}")
    for archive in chosen:
        if is_here(root, data, archive, args.sequence):
            print(f"{archive.file}: is here")
            continue
        size = f", about {archive.about_gb:g} GB" if archive.about_gb and not options.mirror else ""
        print(f"{archive.file}: from {address(archive, options.mirror)}{size}")
        _fetch_with_bar(root, data, archive, args.sequence, options)
    print(f"{root / data.folder}; check it: bgs-bench data check {root / data.folder}")
    return 0


def _fetch_with_bar(root: Path, data: DataSet, archive: Archive, sequences: list[str], options: FetchOptions) -> None:
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task(archive.file, total=None)
        fetch(
            *(root, data, archive, sequences, options),
            report=lambda here, total: bar.update(task, completed=here, total=total),
        )


def _check(args: argparse.Namespace) -> int:
    """Exit code 1 when something must be mended."""
    console = Console(soft_wrap=True, highlight=False)
    overrides = [each for each in args.what if "=" in each]
    folders = [Path(each).expanduser().absolute() for each in args.what if "=" not in each]
    if len(folders) > 1 or (folders and overrides):
        raise BenchError("Give one folder, or dataset=NAME and its settings.")
    load_plugins()
    options = CheckOptions(args.all, args.pictures)
    if overrides:
        dataset = registry.build(compose_run(overrides).plugin("dataset"), "dataset")
        return _show([verdict_on(dataset.label, dataset, options, [])], console)
    if folders:
        return _show(check_folder(folders[0], args.dataset, options), console)
    loaders = registry.names("dataset")
    there = [data for data in manifest() if data.loader in loaders and (data_root() / data.folder).is_dir()]
    if not there:
        raise BenchError(f"{data_root()} holds no data set yet. `bgs-bench data list` says what there is to get.")
    return max(_show(check_folder(data_root() / data.folder, data.loader, options), console) for data in there)


def _show(verdicts: Any, console: Console) -> int:
    wrong = 0
    for verdict in verdicts:
        assert isinstance(verdict, Verdict)
        wrong += bool(verdict.wrong)
        say(f"{verdict.name}: {verdict.about}: {'NOT whole' if verdict.wrong else 'good'}", console)
        for text in verdict.wrong:
            say(f"    wrong: {text}", console)
        for text in verdict.told:
            say(f"    {text}", console)
    return 1 if wrong else 0


def _make(args: argparse.Namespace) -> int:
    if any(each.startswith("dataset=") for each in args.overrides):
        raise BenchError("make NAME chooses the data set; leave dataset= out.")
    require_choice("make", args.name, _MADE)
    root = (args.out or data_root() / _MADE[args.name]).expanduser().absolute()
    dataset = registry.build(compose_run([f"dataset={args.name}", *args.overrides]).plugin("dataset"), "dataset")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task(f"rendering {dataset.label}", total=len(dataset))
        folder = write_kitti(dataset, root, "00", lambda done, total: bar.update(task, completed=done, total=total))
    print(f"{folder}: {len(dataset)} frames. Run: bgs-bench run dataset=kitti dataset.root={root} dataset.sequence=00")
    return 0
