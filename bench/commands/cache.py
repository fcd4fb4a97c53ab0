"""``bgs-bench cache``: what the disk cache of depth maps, sky masks and trajectories holds, and emptying it."""

from __future__ import annotations

import argparse
from collections import defaultdict
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.cache.settings import CacheConfig, default_folder
from bench.cache.store import KINDS, CacheStore, File

_EXAMPLES = """examples:
  bgs-bench cache info
  bgs-bench cache clear --kind stereo
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "cache",
        help="the disk cache of depth maps, sky masks and trajectories: what it holds, clear it",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    info = actions.add_parser("info", help="entries and size of each plugin")
    info.set_defaults(run=_info)
    clear = actions.add_parser("clear", help="remove the entries")
    clear.add_argument(
        "--kind", choices=KINDS, help="only depth maps (stereo), sky masks (sky) or trajectories (tracker)"
    )
    clear.set_defaults(run=_clear)
    for action in (info, clear):
        action.add_argument("--folder", help=f"cache.folder of your runs; default: {default_folder()}")


def _info(args: argparse.Namespace) -> int:
    store = _store(args)
    print(f"folder: {store.folder}")
    groups: dict[tuple[str, str], list[File]] = defaultdict(list)
    for file in store.files():
        kind, plugin = file.path.relative_to(store.folder).parts[:2]
        groups[kind, plugin].append(file)
    for (kind, plugin), files in sorted(groups.items()):
        size = sum(file.size for file in files) / 1e9
        used = datetime.fromtimestamp(max(file.used for file in files)).strftime("%Y-%m-%d %H:%M")
        print(f"{kind:<7} {plugin:<18} {len(files):>7} entries {size:8.3f} GB   last used {used}")
    total = sum(file.size for files in groups.values() for file in files) / 1e9
    print(f"in all {total:.3f} GB; a run keeps it below its cache.limit_gb (default {CacheConfig().limit_gb:g})")
    return 0


def _clear(args: argparse.Namespace) -> int:
    store = _store(args)
    removed, size = store.clear(args.kind)
    print(f"removed {removed} entries, {size / 1e9:.3f} GB, from {store.folder}")
    return 0


def _store(args: argparse.Namespace) -> CacheStore:
    return CacheStore(Path(args.folder).expanduser().absolute() if args.folder else default_folder(), limit=0.0)
