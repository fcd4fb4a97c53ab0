"""Registries as they were before, after tests that load plugins of their own."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import pytest
from hydra.core.config_store import ConfigStore

from bench import registry
from bench.config import compose_run


@pytest.fixture(scope="session")
def composed_once() -> None:
    """Hydra stores its own configs when something is composed for the first time; they must not be forgotten."""
    compose_run([])


@pytest.fixture
def clean_registry(composed_once: None) -> Iterator[None]:
    """Forget, afterwards, every plugin and broken file that the test brought."""
    plugins, broken = dict(registry._plugins), dict(registry.broken_files)
    store = ConfigStore.instance()
    repo = copy.deepcopy(store.repo)
    yield
    registry._plugins.clear()
    registry._plugins.update(plugins)
    registry.broken_files.clear()
    registry.broken_files.update(broken)
    store.repo = repo
