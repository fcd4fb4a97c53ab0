"""The command ``bgs-bench``: one sub-command a file in ``bench/commands``."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from bench.deferred_imports import defer
from bench.errors import BenchError

_COMMANDS = (
    *("run", "list", "table", "reproduce", "evaluate", "score", "map", "stereo-eval", "vocabulary", "weights"),
    *("cache", "new-plugin", "check-plugin", "doctor"),
)
"""Each is a module in ``bench.commands``, in the order of ``--help``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command. Exit code 0 = done, 1 = a run failed, 2 = wrong input, 130 = Ctrl-C."""
    # Read when a command first imports torch: its OpenMP threads would otherwise spin after each operation and take the
    # cores from the C++ core's threads.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    defer()
    try:
        args = _parsed(list(sys.argv[1:] if arguments is None else arguments))
        code: int = args.run(args)
        return code
    except BenchError as error:
        print(f"bgs-bench: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("bgs-bench: interrupted; what was done is in the run folder", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 141


def _parsed(given: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="bgs-bench", description="Benchmark stereo 3D Gaussian Splatting SLAM outdoors."
    )
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    # All of them import torch and more, which takes seconds; the one that is meant may need little of that.
    for command in given[:1] if given and given[0] in _COMMANDS else _COMMANDS:
        importlib.import_module(f"bench.commands.{command.replace('-', '_')}").add_parser(subparsers)
    args, left = parser.parse_known_args(given)
    # argparse takes `run a=1 -m b=2` for two lists of overrides (places of runs, for tables) and fills the first only.
    whole = getattr(args, "overrides", getattr(args, "places", None))
    if left and (whole is None or any(argument.startswith("-") for argument in left)):
        parser.error(f"unrecognized arguments: {' '.join(left)}")
    if whole is not None:
        whole += left
    return args


if __name__ == "__main__":
    sys.exit(main())
