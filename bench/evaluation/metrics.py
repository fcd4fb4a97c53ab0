"""The metrics that evaluators declare, in the order in which tables show them."""

from __future__ import annotations

from bench import registry
from bench.contracts.metric import Metric
from bench.discovery import load_evaluators
from bench.errors import BenchError


def declared_metrics() -> tuple[Metric, ...]:
    """Of all evaluators that are registered, the project's own ones first and then others by name.

    Raises ``BenchError`` when two evaluators declare one key for different numbers.
    """
    load_evaluators()
    found: dict[str, tuple[str, Metric]] = {}
    for name in registry.names("evaluator"):
        for metric in getattr(registry.lookup("evaluator", name).cls, "metrics", ()):
            owner, known = found.setdefault(metric.key, (name, metric))
            if known != metric:
                raise BenchError(
                    f"The evaluators {owner} and {name} both declare a metric {metric.key}. Give one another key."
                )
    return tuple(sorted((metric for _, metric in found.values()), key=lambda metric: metric.order))
