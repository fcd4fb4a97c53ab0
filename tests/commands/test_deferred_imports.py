"""Modules whose execution waits until something is read from them."""

from __future__ import annotations

import importlib
import inspect
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from bench.deferred_imports import defer

SLOW_MODULE = """
import time
runs = globals().get("runs", 0) + 1
time.sleep(0.05)
answer = 42
def __getattr__(name):
    if name == "computed":
        return 43
    raise AttributeError(name)
"""


@pytest.fixture
def slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = f"slow_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text(SLOW_MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    defer([name, "no_such_module_anywhere"])
    assert "no_such_module_anywhere" not in sys.modules
    return name


def test_runs_once_when_something_is_read(slow: str) -> None:
    module = __import__(slow)
    assert inspect.getmodule(test_runs_once_when_something_is_read) is sys.modules[__name__]
    assert module.__file__.endswith(f"{slow}.py")
    assert "answer" not in vars(module)
    assert (module.computed, module.answer, module.runs) == (43, 42, 1)
    with pytest.raises(AttributeError):
        module.no_such_name  # noqa: B018
    assert module.runs == 1


def test_a_part_is_imported_after_the_whole_and_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `import torch.nn.functional` at the top of a plugin: torch.nn crashes where torch was not executed before."""
    name = f"whole_{tmp_path.name}".replace("-", "_")
    for folder in (tmp_path / name, tmp_path / name / "part"):
        folder.mkdir()
    (tmp_path / name / "__init__.py").write_text(f"order = ['whole']\nimport {name}.part.leaf\n")
    (tmp_path / name / "part" / "__init__.py").write_text(f"import {name}\n{name}.order.append('part')\n")
    (tmp_path / name / "part" / "leaf.py").write_text(f"import {name}\n{name}.order.append('leaf')\n")
    (tmp_path / name / "other.py").write_text(f"import {name}\n{name}.order.append('other')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    defer([name])
    leaf = importlib.import_module(f"{name}.part.leaf")
    assert sys.modules[name].order == ["whole", "part", "leaf"]
    assert leaf is sys.modules[f"{name}.part.leaf"]
    assert leaf.__spec__ is not None
    assert leaf.__spec__.origin == leaf.__file__
    importlib.import_module(f"{name}.other")
    assert sys.modules[name].order == ["whole", "part", "leaf", "other"]


def test_threads_wait_for_the_first(slow: str) -> None:
    found: list[int] = []
    threads = [threading.Thread(target=lambda: found.append(__import__(slow).answer)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [42] * 4
    assert sys.modules[slow].runs == 1


def test_listing_executes_no_slow_module(tmp_path: Path) -> None:
    executed = "[name for name in SLOW if '_load' not in vars(sys.modules[name])]"
    imports = "import sys; from bench.cli import main; from bench.deferred_imports import SLOW"
    code = f"{imports}; main(['list']); print({executed})"
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ).stdout.splitlines()
    assert "sgbm" in " ".join(said)
    assert said[-1] == "[]"
