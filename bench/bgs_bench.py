"""Where ``bgs-bench`` begins: is ``bench`` this project's? Another distribution of that name (frappe-bench) writes its
files over these when it is installed into the same environment, and this one, which it does not have, stays."""

from __future__ import annotations

import sys

import bench


def main() -> int:
    """As ``bench.cli.main``; exit code 2 with a sentence where ``bench`` is another distribution's."""
    if getattr(bench, "DISTRIBUTION", "") != "bgs-slam-bench":
        print(
            f"bgs-bench: {bench.__file__} is another distribution's `bench`, installed over that of bgs-slam-bench. "
            "Install bgs-slam-bench into an environment of its own: python -m venv NAME && NAME/bin/pip install ...",
            file=sys.stderr,
        )
        return 2
    from bench.cli import main as command

    return command()
