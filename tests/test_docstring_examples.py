"""The examples in docstrings are true."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


FILES = sorted(file for file in (ROOT / "bench").rglob("*.py") if "    >>> " in file.read_text())


@pytest.mark.parametrize("file", FILES, ids=[file.stem for file in FILES])
def test_examples_are_true(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    module = importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0
