"""The command ``bgs-bench``: one sub-command a file in ``bench/commands``."""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import os
import sys
from collections.abc import Sequence
from typing import Any

from bench import DISTRIBUTION
from bench.deferred_imports import defer
from bench.errors import BenchError
from bench.terminal import output_error, print_anywhere, tell

_NOBODY_READS = 141  # 128 + SIGPIPE, as other programs end then
COMMANDS = (
    *("run", "list", "table", "reproduce", "evaluate", "score", "map", "view", "compare", "report", "figure", "video"),
    *("stereo-eval", "vocabulary", "data", "weights", "cache", "new-plugin", "check-plugin", "doctor", "completion"),
)
"""Each is a module in ``bench.commands``, in the order of ``--help``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command. Exit code 0 = done, 1 = a run failed, 2 = wrong input, 130 = Ctrl-C, 141 = nobody reads on."""
    # Read when a command first imports torch: its OpenMP threads would otherwise spin after each operation and take the
    # cores from the C++ core's threads.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    defer()
    print_anywhere()
    by_argparse: SystemExit | None = None
    try:
        code = _code_of(_parsed(list(sys.argv[1:] if arguments is None else arguments)))
    except SystemExit as error:  # it has printed its help, or what it does not take
        code, by_argparse = 0, error
    except OSError as error:
        return _without_output(error, 1)
    lost = output_error()
    if lost is not None:
        return _without_output(lost, code)
    if by_argparse is not None:
        raise by_argparse
    return code


def _code_of(args: argparse.Namespace) -> int:
    """Run the command; its exit code, when what went wrong has been told in a line."""
    try:
        code: int = args.run(args)
        return code
    except BenchError as error:
        tell(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        tell("interrupted; what was done is in the run folder")
        return 130
    except BrokenPipeError as error:
        return _without_output(error, 1)
    except OSError as error:
        lost = None if error.filename else output_error(probe=True)
        if lost is not None:
            return _without_output(lost, 1)
        where = f"{error.filename}: " if error.filename else ""
        tell(f"{where}{error.strerror or error}. Check the place, its permissions and the free space.")
        return 1
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):  # rich ends the program then
            return _NOBODY_READS
        tell(f"a plugin ended the program (SystemExit: {error.code}); a plugin that can't go on raises an error")
        return 1


def _without_output(lost: OSError, code: int) -> int:
    """The exit code where standard output takes nothing more; quiet where its reader has left (``| head``)."""
    if isinstance(lost, BrokenPipeError):
        output_error()
        return _NOBODY_READS
    tell(f"Can't write to standard output: {lost.strerror}. What was printed is not complete.")
    return code or 1


class _Parser(argparse.ArgumentParser):
    def _print_message(self, message: str, file: Any = None) -> None:
        """As argparse does, which does not tell when that fails."""
        if message and (file or sys.stderr) is not None:
            (file or sys.stderr).write(message)


def parser_of(commands: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of ``bgs-bench`` with these sub-commands; each is imported for it."""
    parser = _Parser(prog="bgs-bench", description="Benchmark stereo 3D Gaussian Splatting SLAM outdoors.")
    parser.add_argument("--version", action="version", version=f"bgs-bench {importlib.metadata.version(DISTRIBUTION)}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in commands:
        importlib.import_module(f"bench.commands.{command.replace('-', '_')}").add_parser(subparsers)
    return parser


def _parsed(given: list[str]) -> argparse.Namespace:
    # All of them import torch and more, which takes seconds; the one that is meant may need little of that.
    parser = parser_of(given[:1] if given and given[0] in COMMANDS else COMMANDS)
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
