"""Fixtures shared by all tests: where the real data and the real weights are, and the plugins."""

from __future__ import annotations

import copy
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

# As the command line does, and before torch is imported: OpenMP threads that wait must not take the cores from others.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# No test reads what this machine's user has downloaded.
os.environ["BGS_DATA"] = str(Path(__file__).parent / "no_data_here")

import torch
from hydra.core.config_store import ConfigStore

from bench import registry
from bench.config import compose_run
from bench.discovery import load_plugins
from tests.street_made_once import remember_streets

_CHROMIUM = Path(os.environ.get("BGS_CHROMIUM") or "/usr/bin/chromium")
# The tests may run as root, and no GPU is needed.
_OPTIONS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def _folder_from(variable: str) -> Path:
    value = os.environ.get(variable, "")
    if not value or not Path(value).is_dir():
        pytest.skip(f"{variable} is not set to an existing folder; see CONTRIBUTING.md")
    return Path(value).resolve()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked ``cuda`` run where there is a device."""
    if item.get_closest_marker("cuda") is not None and not torch.cuda.is_available():
        pytest.skip("torch sees no CUDA device here")


@pytest.fixture(scope="session")
def test_data() -> Path:
    """The folder of real data-set samples (``BGS_TEST_DATA``)."""
    return _folder_from("BGS_TEST_DATA")


@pytest.fixture(scope="session")
def kitti_root(test_data: Path) -> Path:
    """A KITTI odometry root with samples of sequences 03 and 06."""
    return test_data / "kitti_odometry"


@pytest.fixture(scope="session")
def weights_root() -> Path:
    """The folder of real network weights (``BGS_WEIGHTS``)."""
    return _folder_from("BGS_WEIGHTS")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, without a window."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed; make browser-test")
    if not _CHROMIUM.is_file():
        pytest.skip(f"there is no {_CHROMIUM}; install Chromium, or name it in BGS_CHROMIUM")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=str(_CHROMIUM), args=_OPTIONS)
        yield started
        started.close()


@pytest.fixture(scope="session", autouse=True)
def _ctrl_c_reaches_children() -> None:
    """In the background a shell tells the tests to ignore Ctrl-C, and what they start would inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _plugins() -> None:
    load_plugins()


@pytest.fixture(scope="module", autouse=True)
def _streets_made_once(request: pytest.FixtureRequest) -> Iterator[None]:
    """But for the tests of the street itself."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name not in ("datasets", "street", "performance"):
            remember_streets(patch)
        yield


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
