"""``bgs-bench view``: a run's map, cameras and images in the browser."""

from __future__ import annotations

import argparse
import importlib.util
import socket
import threading
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.terminal import say
from bench.viewers.page import Page

_EXAMPLES = """examples:
  bgs-bench view results/runs/3f2a9c01d4e5
  bgs-bench view results/runs/3f2a9c01d4e5 --max-gaussians 300000
"""
_MOST = 1_000_000
_LAST_PORT = 64_000
"""viser tries the thousand ports from the one that it is given."""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "view",
        help="a run's map, cameras and images in the browser",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("run_folder", type=Path, metavar="RUN_FOLDER")
    parser.add_argument(
        "--host", default="127.0.0.1", help="where it listens (default: this machine alone; 0.0.0.0: anybody may look)"
    )
    parser.add_argument("--port", type=int, default=8080, help="the first port that is tried (default: 8080)")
    parser.add_argument(
        "--max-gaussians",
        type=int,
        default=_MOST,
        metavar="N",
        help=f"of a larger map those that cover most (default: {_MOST})",
    )
    parser.add_argument(
        "--plugins", action="append", default=[], metavar="FOLDER", help="a folder of plugins that the run needs"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; ``BenchError`` where viser is missing, or the folder has no map."""
    if importlib.util.find_spec("viser") is None:
        raise BenchError("viser is not installed. Run: pip install 'bgs-slam-bench[viewer]'")
    if args.max_gaussians < 1:
        raise BenchError(f"--max-gaussians {args.max_gaussians} is too small; the least is 1.")
    if not 0 < args.port <= _LAST_PORT:
        raise BenchError(f"--port {args.port} must lie between 1 and {_LAST_PORT}.")
    _require_own(args.host)
    # Of the command line alone: code that the run folder names is a stranger's.
    load_plugins(args.plugins)
    console = Console()
    page = Page(SavedRunFolder(args.run_folder), args.host, args.port, args.max_gaussians)
    for note in page.notes:
        say(note, console)
    say(f"{page.url} shows {args.run_folder}; Ctrl-C ends it", console)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        return 0
    finally:
        page.stop()
    return 0


def _require_own(host: str) -> None:
    """Raise ``BenchError`` where nothing can listen: viser would wait for ever."""
    try:
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        socket.create_server((address[0], 0), family=family).close()
    except OSError as error:
        raise BenchError(
            f"--host {host} is no address of this machine ({error}). Leave it out for 127.0.0.1."
        ) from error
