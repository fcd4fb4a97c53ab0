"""What an evaluator's number is: enough to find it in ``metrics.json`` and to show it anywhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from bench.errors import BenchError, require_choice

BETTER = ("higher", "lower")
COLUMNS = ("always", "known", "never")


@dataclass(frozen=True)
class Metric:
    """A number that an evaluator gives. Declared once, it appears in every table, CSV file, record and report."""

    key: str
    """Its name in CSV files and in ``conf/table``, with the unit at its end: ``"ate_rmse_m"``."""
    title: str
    """The heading that people read, without the unit: ``"ATE"``."""
    unit: str = ""
    """As shown after the heading: ``"m"``, ``"dB"``; empty where there is none."""
    better: Literal["higher", "lower"] | None = None
    """Which values are better; None where that is not known."""
    decimals: int | None = 3
    """Digits after the point where people read it; None: a whole number, with commas between thousands."""
    path: str = ""
    """Its dotted place in ``metrics.json``, for example ``"views.left.psnr_db"``; several places joined by `` + `` are
    added up, those that are known. By default the key itself."""
    column: Literal["always", "known", "never"] = "known"
    """Whether the table of runs has a column for it: always, where a run has a value, or never (it is for named tables
    then)."""
    of_part: bool = True
    """Whether a run that stopped early has it too (it has no peak memory of the whole sequence)."""
    order: int = 1000
    """Its place among the columns, smaller ones first; equal ones are ordered by the name of their evaluator."""

    def __post_init__(self) -> None:
        """Check the values; raises ``BenchError``."""
        if not self.key.isidentifier():
            raise BenchError(f"The metric key '{self.key}' must consist of letters, digits and _, as in 'ate_rmse_m'.")
        if self.better is not None:
            require_choice(f"better of the metric {self.key}", self.better, BETTER)
        require_choice(f"column of the metric {self.key}", self.column, COLUMNS)
        if self.decimals is not None and self.decimals < 0:
            raise BenchError(f"The metric {self.key} can't have {self.decimals} decimals; give 0 or more, or None.")

    @cached_property
    def places(self) -> list[list[str]]:
        """The keys that lead to its value, for each value that is added up."""
        return [place.strip().split(".") for place in (self.path or self.key).split("+")]

    def value_in(self, metrics: Mapping[str, Any]) -> float | None:
        """Its value in the contents of a ``metrics.json``, or None where it is not known."""
        found = [_at(metrics, place) for place in self.places]
        known = [value for value in found if isinstance(value, (int, float)) and not isinstance(value, bool)]
        return (sum(known) if len(found) > 1 else known[0]) if known else None


def _at(metrics: Any, place: list[str]) -> Any:
    for key in place:
        metrics = metrics.get(key) if isinstance(metrics, Mapping) else None
    return metrics
