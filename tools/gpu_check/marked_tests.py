"""The tests that are marked ``cuda``, counted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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


def measure(arguments: Sequence[str] = ("-m", "cuda", "tests")) -> Iterator[dict[str, Any]]:
    """Yields how many passed and were skipped, and the names of those that failed; ``BenchError`` unless all passed."""
    import pytest

    counts = _Counts()
    code = int(pytest.main(["-q", "-p", "no:cacheprovider", *arguments], plugins=[counts]))
    yield {"passed": counts.passed, "skipped": counts.skipped, "failed": counts.failed}
    if code or counts.skipped or not counts.passed:
        raise BenchError(
            f"pytest ended with {code}: {counts.passed} tests passed, {counts.skipped} were skipped, and failed: "
            f"{', '.join(counts.failed) or 'none'}"
        )
