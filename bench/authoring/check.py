"""Checks a plugin against the contract of its kind."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from types import ModuleType

from bench.authoring.candidate import FOR_ALL_KINDS, candidate_of
from bench.authoring.verdict import Candidate, Finding, run_checks
from bench.registry import OBSERVERS


def check_plugin(*overrides: str, folders: Sequence[str] = ()) -> list[Finding]:
    """All findings about the plugin that the first ``KIND=NAME`` names; ``overrides`` as for ``bgs-bench run``.

    ``folders``: plugin folders of the author's. Raises ``BenchError`` for an unknown name or a wrong setting.
    """
    return list(findings_of(candidate_of(overrides, folders)))


def findings_of(candidate: Candidate) -> Iterator[Finding]:
    """The findings as they are made: first what holds for every kind, then the contract of the plugin's own."""
    general = list(run_checks(candidate.plugin, candidate, FOR_ALL_KINDS))
    yield from general
    if any(finding.state == "FAILED" and finding.title != "config" for finding in general):
        return
    module = checks_for(candidate.plugin.kind)
    subject = module.Subject(candidate)
    yield from run_checks(candidate.plugin, subject, module.checks_of(subject))


def checks_for(kind: str) -> ModuleType:
    """The module of a kind's checks, with ``Subject`` and ``checks_of``; it brings what it needs when asked for."""
    return importlib.import_module(f"bench.authoring.{'observer' if kind in OBSERVERS else kind}_checks")
