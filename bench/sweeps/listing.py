"""A plan of runs in lines: what would be made and where, and what can't be."""

from __future__ import annotations

from rich.console import Console

from bench.sweeps.lookup import look_up
from bench.sweeps.plan import Plan
from bench.sweeps.sweep import Choice
from bench.terminal import say


def list_plan(plan: Plan, choice: Choice, console: Console) -> None:
    """A line for each run, in order, with its folder and why others are left: what ``--dry-run`` says."""
    for planned in plan.runs:
        found = look_up(planned.folder)
        reason = f" ({found.reason})" if found.reason else ""
        what = "run " if choice.wants(found.progress) else "keep"
        frames = f"{planned.frames} frames, " if planned.frames else ""
        say(f"{what} {found.progress}{reason}: {planned.label}, {frames}{planned.folder}", console)
    list_skipped(plan, console)


def list_skipped(plan: Plan, console: Console) -> None:
    """A line for each reason, with the cells that it keeps from being run."""
    by_reason: dict[str, list[str]] = {}
    for skipped in plan.skipped:
        by_reason.setdefault(skipped.reason, []).append(
            ", ".join(filter(None, (skipped.cell.row, skipped.cell.column)))
        )
    for reason, labels in by_reason.items():
        more = f" and {len(labels) - 2} more" if len(labels) > 2 else ""
        say(f"skipped: {'; '.join(labels[:2])}{more}: {reason}", console)
