"""``bgs-bench list``: every plugin, whether it can run here, and why not."""

from __future__ import annotations

import argparse
from typing import Any

from bench import registry
from bench.discovery import load_plugins
from bench.errors import require_choice


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser("list", help="every plugin, available or not and why")
    parser.add_argument("kind", nargs="?", help=f"one of {', '.join(registry.KINDS)}; default: all")
    parser.add_argument("--plugins", action="append", default=[], metavar="FOLDER", help="a folder of your own plugins")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print one line a plugin, then one a file that failed to import; ``BenchError`` for an unknown kind."""
    kinds = registry.KINDS if args.kind is None else (require_choice("kind", args.kind, registry.KINDS),)
    load_plugins(args.plugins)
    plugins = [registry.lookup(kind, name) for kind in kinds for name in registry.names(kind)]
    width = max((len(plugin.name) for plugin in plugins), default=0)
    for plugin in plugins:
        reason = plugin.unavailable_reason()
        state = "available    " if reason is None else "unavailable  "
        words = plugin.summary if reason is None else " ".join(reason.split())
        print(f"{plugin.kind:<10} {plugin.name:<{width}}  {state}{words}")
    # A file that failed to import may hold any kind of plugin, so each listing shows it.
    for file, why in sorted(registry.broken_files.items()):
        print(f"{'broken':<10} {file}: {' '.join(why.split())}")
    return 0
