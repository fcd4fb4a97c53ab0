"""What computing an answer took, whether it was computed now or came from the cache."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """What computing an answer took, in seconds; for one from the cache, what it took when it was computed."""

    seconds: float
    cached: bool


def cost_of(part: object, measured_s: float) -> Cost:
    """The cost of the last answer of ``part``, which took ``measured_s`` seconds to come.

    Reading and writing the cache is left out, so that a run's times are those of its parts with or without it.
    """
    last = getattr(part, "last_cost", None)
    return last if isinstance(last, Cost) else Cost(measured_s, cached=False)
