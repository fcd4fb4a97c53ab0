"""The bar in the terminal while a run is scored."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, TaskID

from bench.evaluation.saved_run import ProgressReport


@contextmanager
def scoring_progress(console: Console, doing: str = "scoring") -> Iterator[ProgressReport]:
    """Give what is called with what is scored, how much is done and how much there is; gone after the block."""
    with Progress(console=console, transient=True, disable=not console.is_interactive) as bar:
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(f"{doing} {what}")
            bar.update(tasks[what], completed=done, total=total)

        yield show
