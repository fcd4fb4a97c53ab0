"""When, from which code and on what runs were made, in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from bench.tables.records.record import RunRecord


def made_in_words(runs: Sequence[RunRecord]) -> list[str]:
    """Days, commits and machines of the runs, each as one part; without what no run knows."""
    known = [_each(run.date for run in runs)]
    commits = _each(_commit(run.provenance.get("git")) for run in runs)
    known.append(f"code {commits}" if commits else "")
    known.append(_machines([run.provenance.get("machine") for run in runs]))
    return [part for part in known if part]


def _commit(git: Any) -> str:
    if not isinstance(git, dict) or not git.get("commit"):
        return ""
    return f"{str(git['commit'])[:7]}{' with changes' if git.get('dirty') else ''}"


def _machines(machines: Sequence[Any]) -> str:
    """Each kind of machine, with the yardstick's span over the runs on it: ``torch.mm`` of 1024^3."""
    found: dict[str, list[float]] = {}
    for machine in machines:
        if isinstance(machine, dict) and machine.get("cpu"):
            name = f"{machine['cpu']}, {machine.get('usable_cores')} cores, {machine.get('gpu') or 'no GPU'}"
            mm_ms = machine.get("mm_ms")
            found.setdefault(name, []).extend(
                [mm_ms] if isinstance(mm_ms, int | float) and math.isfinite(mm_ms) else []
            )
    return "; ".join(name + _span(found[name]) for name in sorted(found))


def _span(mm_ms: list[float]) -> str:
    if not mm_ms:
        return ""
    low, high = round(min(mm_ms)), round(max(mm_ms))
    return f", mm 1024^3 {low} ms" if low == high else f", mm 1024^3 {low} to {high} ms"


def _different(texts: Iterable[str]) -> list[str]:
    return sorted({text for text in texts if text})


def _each(texts: Iterable[str]) -> str:
    return ", ".join(_different(texts))
