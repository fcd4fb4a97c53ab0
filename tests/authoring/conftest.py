"""Plugins written into a temporary folder, and the registries as they were before, after each test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore

from bench import registry
from bench.authoring import check
from bench.authoring.candidate import candidate_of
from bench.authoring.scaffold import write_plugin
from bench.authoring.verdict import Check, Finding, run_checks


@pytest.fixture(autouse=True)
def _registry_as_before() -> Iterator[None]:
    plugins, broken = dict(registry._plugins), dict(registry.broken_files)
    repo = ConfigStore.instance().repo
    stored = {kind: dict(repo.get(kind, {})) for kind in registry.KINDS}
    yield
    registry._plugins.clear()
    registry._plugins.update(plugins)
    registry.broken_files.clear()
    registry.broken_files.update(broken)
    repo.update(stored)


MakeFinding = Callable[..., Finding]


@pytest.fixture
def finding_about(tmp_path: Path) -> MakeFinding:
    """The finding of one check, ``title``, about a new plugin of a kind after replacements in its text."""

    def finding(kind: str, title: str, *changes: tuple[str, str]) -> Finding:
        file = write_plugin(kind, "probed", tmp_path).file
        text = file.read_text()
        for old, new in changes:
            assert text.count(old) == 1, f"{old!r} is {text.count(old)} times in the template"
            text = text.replace(old, new)
        file.write_text(text)
        candidate = candidate_of([f"{kind}=probed"], [str(tmp_path)])
        module = check.checks_for(kind)
        subject = module.Subject(candidate)
        (chosen,) = (one for one in module.checks_of(subject) if one.title == title)
        (found,) = run_checks(candidate.plugin, subject, [Check(title, chosen.run)])
        return found

    return finding
