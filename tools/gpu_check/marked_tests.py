"""The tests that are marked ``cuda``, counted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.errors import BenchError

if TYPE_CHECKING:
    import pytest


class _Counts:
    def __init__(self) -> None:
        self.passed, self.failed, self.skipped = 0, list[str](), 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test passes in its call; it may fail or be skipped in its fixtures too."""
        self.passed += report.passed and report.when == "call"
        self.skipped += report.skipped
        if report.failed:
            self.failed.append(report.nodeid)


def files_with_marks(folder: Path = Path("tests")) -> list[str]:
    """Only these are imported: others may want packages that this machine lacks."""
    return [str(file) for file in sorted(folder.rglob("test_*.py")) if "mark.cuda" in file.read_text(encoding="utf-8")]


def measure() -> Iterator[dict[str, Any]]:
    """Yields how many passed and were skipped, and the names of those that failed; ``BenchError`` unless all passed."""
    import pytest

    counts = _Counts()
    code = int(pytest.main(["-q", "-p", "no:cacheprovider", "-m", "cuda", *files_with_marks()], plugins=[counts]))
    yield {"passed": counts.passed, "skipped": counts.skipped, "failed": counts.failed}
    if code or counts.skipped or not counts.passed:
        raise BenchError(
            f"pytest ended with {code}: {counts.passed} tests passed, {counts.skipped} were skipped, and failed: "
            f"{', '.join(counts.failed) or 'none'}"
        )
