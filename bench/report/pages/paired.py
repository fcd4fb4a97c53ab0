"""Two settings of a sweep compared over the seeds that both have."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass

from scipy import stats

from bench.contracts.metric import Metric
from bench.report.pages.sweeps import Sweep
from bench.tables.collect import Row

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Difference:
    """The second setting minus the first, of one metric: mean over ``n`` seeds, and its confidence interval.

    ``low`` and ``high`` are None for a single seed, which tells nothing of the spread.
    """

    metric: Metric
    first: float
    second: float
    mean: float
    low: float | None
    high: float | None
    n: int

    @property
    def verdict(self) -> str:
        """Which of the two is better, where the interval leaves out 0 and it is known what is better."""
        if self.low is None or self.high is None:
            return "one seed tells no spread"
        if self.low <= 0.0 <= self.high:
            return "no difference shown"
        if self.metric.better is None:
            return "they differ"
        return "second better" if (self.mean > 0) == (self.metric.better == "higher") else "first better"

    def line(self) -> tuple[str, ...]:
        """Metric, both means, the difference and its interval, the seeds, the verdict, as people read them."""
        digits = 1 if self.metric.decimals is None else self.metric.decimals + 1
        signed = ("-" if value is None else f"{value:+.{digits}f}" for value in (self.mean, self.low, self.high))
        name = f"{self.metric.title} [{self.metric.unit}]" if self.metric.unit else self.metric.title
        return name, f"{self.first:.{digits}f}", f"{self.second:.{digits}f}", *signed, str(self.n), self.verdict


@dataclass(frozen=True)
class Pair:
    """Two groups that differ in one setting, the seeds that both have, and the differences of all metrics."""

    title: str
    seeds: tuple[int, ...]
    differences: tuple[Difference, ...]

    @property
    def lines(self) -> list[tuple[str, ...]]:
        """A line of a table for each metric, "-" where a value is not known."""
        return [each.line() for each in self.differences]


def difference(metric: Metric, first: list[float], second: list[float]) -> Difference:
    """Paired, seed by seed; the interval is that of Student's t for the mean of the differences."""
    gaps = [b - a for a, b in zip(first, second, strict=True)]
    low = high = None
    if len(gaps) > 1:
        if len(set(gaps)) == 1:
            low = high = gaps[0]
        else:
            interval = stats.ttest_rel(second, first).confidence_interval(CONFIDENCE)
            low, high = float(interval.low), float(interval.high)
    means = statistics.fmean(first), statistics.fmean(second), statistics.fmean(gaps)
    return Difference(metric, *means, low, high, len(gaps))


def pairs_of(sweep: Sweep) -> Iterator[Pair]:
    """All two groups that differ in exactly one setting and have seeds in common."""
    for one, other in itertools.combinations(sweep.groups, 2):
        differing = [(key, title) for key, title in sweep.keys if one.values.get(key) != other.values.get(key)]
        if len(differing) != 1:
            continue
        (key, title), seeds = differing[0], _values(one, other)
        if not seeds:
            continue
        found = []
        for metric in sweep.metrics:
            both = [(a[metric.key], b[metric.key]) for a, b in seeds.values() if metric.key in a and metric.key in b]
            both = [each for each in both if math.isfinite(sum(each))]
            if both:
                found.append(difference(metric, *(list(side) for side in zip(*both, strict=True))))
        rest = sweep.rest(one, [key])
        named = f"{title}: {one.values.get(key)} and {other.values.get(key)}{f' ({rest})' if rest else ''}"
        yield Pair(named, tuple(seeds), tuple(found))


def _values(one: Row, other: Row) -> dict[int, tuple[dict[str, float], dict[str, float]]]:
    """The values of the two groups' runs by the seeds that both have."""
    first, second = ({run.seed: run.values for run in row.runs} for row in (one, other))
    return {seed: (first[seed], second[seed]) for seed in sorted(first.keys() & second.keys())}
