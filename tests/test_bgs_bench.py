"""Where the command begins: another distribution's ``bench`` is told, in a sentence and not by a traceback."""

import pytest

import bench
from bench.bgs_bench import main


def test_another_bench_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delattr(bench, "DISTRIBUTION")  # as frappe-bench's __init__.py has none
    assert main() == 2
    said = capsys.readouterr().err
    assert "__init__.py is another distribution's `bench`" in said
    assert said.count("\n") == 1
