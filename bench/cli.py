"""The command ``bgs-bench``: one sub-command a file in ``bench/commands``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from bench.errors import BenchError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a sub-command. Exit code 0 = done, 1 = a run failed, 2 = wrong input, 130 = Ctrl-C."""
    # Read when torch is first imported, below: its OpenMP threads would otherwise spin after each operation and take
    # the cores from the C++ core's threads.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    from bench.commands import (
        cache,
        check_plugin,
        doctor,
        evaluate,
        list,
        new_plugin,
        reproduce,
        run,
        score,
        stereo_eval,
        table,
        vocabulary,
        weights,
    )

    parser = argparse.ArgumentParser(
        prog="bgs-bench", description="Benchmark stereo 3D Gaussian Splatting SLAM outdoors."
    )
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    of_runs = (run, list, table, reproduce, evaluate, score, stereo_eval)
    for command in (*of_runs, vocabulary, weights, cache, new_plugin, check_plugin, doctor):
        command.add_parser(subparsers)
    args, left = parser.parse_known_args(arguments)
    # argparse takes `run a=1 -m b=2` for two lists of overrides and knows a place for the first only.
    if left and (not hasattr(args, "overrides") or any(argument.startswith("-") for argument in left)):
        parser.error(f"unrecognized arguments: {' '.join(left)}")
    if left:
        args.overrides += left
    try:
        code: int = args.run(args)
        return code
    except BenchError as error:
        print(f"bgs-bench: {error}", file=sys.stderr)
        return 1 if isinstance(error, run.RunFailedError) else 2
    except KeyboardInterrupt:
        print("bgs-bench: interrupted; what was done is in the run folder", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 141


if __name__ == "__main__":
    sys.exit(main())
