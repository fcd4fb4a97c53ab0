"""When, from which code and on what runs were made, in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from bench.tables.records.record import RunRecord


def made_in_words(runs: Sequence[RunRecord]) -> list[str]:
    """Days, commits and machines of the runs, each as one part; without what no run knows."""
    known = [_each(run.date for run in runs)]
    commits = _each(_commit(run.provenance.get("git")) for run in runs)
    known.append(f"code {commits}" if commits else "")
    known.append("; ".join(_different(_machine(run.provenance.get("machine")) for run in runs)))
    return [part for part in known if part]


def _commit(git: Any) -> str:
    if not isinstance(git, dict) or not git.get("commit"):
        return ""
    return f"{str(git['commit'])[:7]}{' with changes' if git.get('dirty') else ''}"


def _machine(machine: Any) -> str:
    if not isinstance(machine, dict) or not machine.get("cpu"):
        return ""
    return f"{machine['cpu']}, {machine.get('usable_cores')} cores, {machine.get('gpu') or 'no GPU'}"


def _different(texts: Iterable[str]) -> list[str]:
    return sorted({text for text in texts if text})


def _each(texts: Iterable[str]) -> str:
    return ", ".join(_different(texts))
