"""``bgs-bench new-plugin``: the first file of a plugin and its test, ready to run."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from bench.authoring.scaffold import Place, write_plugin
from bench.discovery import load_plugins, plugin_files
from bench.registry import KINDS

_EXAMPLES = """examples:
  bgs-bench new-plugin stereo my_net
  bgs-bench new-plugin loss my_term --folder ~/mine
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "new-plugin",
        help="write the one file of a new plugin, and its test",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("kind", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("name", metavar="NAME", help="letters, digits and _: what stands behind KIND= later")
    parser.add_argument(
        "--folder", type=Path, metavar="DIR", help="default: plugins/ of the checkout, or ./my_plugins when installed"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the files and print what to type next; ``BenchError`` for a name that can't be used."""
    has_others = args.folder is not None and bool(plugin_files(args.folder.expanduser()))
    load_plugins([str(args.folder)] if has_others else [])
    place = write_plugin(args.kind, args.name, args.folder)
    print(f"wrote {_shown(place.file)}")
    print(f"wrote {_shown(place.test)}")
    print("next:")
    for line in next_commands(args.kind, args.name, place):
        print(f"  {line}")
    return 0


def next_commands(kind: str, name: str, place: Place) -> list[str]:
    """What the author types next, as a shell reads it."""
    folder = "" if place.own_folder is None else " " + shlex.quote(f"plugins=[{_shown(place.own_folder)}]")
    chosen = f"{kind}={name}"
    # Of losses and evaluators a run has several; the new one joins those of the default system.
    used = {"loss": f"'loss=[rgb,ssim,geo,{name}]'", "evaluator": f"'evaluator=[ate,image,{name}]'"}.get(kind, chosen)
    row = [f"bgs-bench reproduce backbones {chosen}{folder} dataset.root=KITTI"] if kind == "stereo" else []
    return [
        f"bgs-bench check-plugin {chosen}{folder}",
        f"bgs-bench run {used}{folder}",
        *row,
        f"python -m pytest {shlex.quote(_shown(place.test))}",
    ]


def _shown(path: Path) -> str:
    absolute = path.expanduser().absolute()
    return str(absolute.relative_to(Path.cwd())) if absolute.is_relative_to(Path.cwd()) else str(absolute)
