"""The metrics that evaluators declare, in the order in which tables show them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from functools import cache
from typing import Any

from bench import registry
from bench.contracts.metric import Metric
from bench.discovery import is_builtin, load_evaluators
from bench.errors import BenchError

_MOST_DECIMALS = 15
"""A float has no more."""
DECLARED = "declared"
"""Where ``metrics.json`` keeps what evaluators from elsewhere declare: tables need it when these are not there."""


def declared_metrics() -> tuple[Metric, ...]:
    """Of all evaluators that are registered, the project's own first and then others by name.

    Raises ``BenchError`` when two evaluators declare one key for different numbers.
    """
    load_evaluators()
    return _declared(tuple(registry.names("evaluator")))


def brought_with(evaluators: Iterable[str]) -> list[dict[str, Any]]:
    """What of these evaluators are not the project's own declare, as plain data; ``metrics_from`` reads it."""
    brought = [registry.lookup("evaluator", name) for name in evaluators]
    return [asdict(metric) for plugin in brought if not is_builtin(plugin) for metric in plugin.cls.metrics]  # type: ignore[attr-defined]


def metrics_from(declared: Any) -> list[Metric]:
    """The metrics in what ``brought_with`` gave; those that this version of the project can't read are left out."""
    found = []
    for values in declared if isinstance(declared, list) else ():
        try:
            metric = Metric(**values)
        except (TypeError, AttributeError, BenchError):
            continue
        if _is_sound(metric):
            found.append(metric)
    return found


def _is_sound(metric: Metric) -> bool:
    """Whether its values are of the types that tables work with: a run folder can say anything."""
    texts = (metric.key, metric.title, metric.unit, metric.path)
    counts = (metric.order, metric.decimals or 0)
    return (
        all(isinstance(text, str) for text in texts)
        and all(isinstance(count, int) for count in counts)
        and (metric.decimals or 0) <= _MOST_DECIMALS
    )


@cache
def _declared(evaluators: tuple[str, ...]) -> tuple[Metric, ...]:
    found: dict[str, tuple[str, Metric]] = {}
    for name in evaluators:
        for metric in getattr(registry.lookup("evaluator", name).cls, "metrics", ()):
            owner, known = found.setdefault(metric.key, (name, metric))
            if known != metric:
                raise BenchError(
                    f"The evaluators {owner} and {name} both declare a metric {metric.key}. Give one another key."
                )
    return tuple(sorted((metric for _, metric in found.values()), key=lambda metric: metric.order))
