"""The command ``bgs-bench``: one sub-command a file in ``bench/commands``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from bench.errors import BenchError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command. Exit code 0 = done, 1 = a run failed, 2 = wrong input (one line, no traceback), 130 = Ctrl-C."""
    from bench.commands import evaluate, list, run, table

    parser = argparse.ArgumentParser(
        prog="bgs-bench", description="Benchmark stereo 3D Gaussian Splatting SLAM outdoors."
    )
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in (run, list, table, evaluate):
        command.add_parser(subparsers)
    args = parser.parse_args(arguments)
    try:
        code: int = args.run(args)
        return code
    except BenchError as error:
        print(f"bgs-bench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("bgs-bench: interrupted; what was done is in the run folder", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 141


if __name__ == "__main__":
    sys.exit(main())
